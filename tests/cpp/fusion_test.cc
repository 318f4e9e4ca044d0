#include "fusion.h"

#include <set>

#include <gtest/gtest.h>

#include "plane_scene.h"

namespace sirpy {
namespace {

const Eigen::Vector3d kNormal = Eigen::Vector3d(0.3, -0.2, -1).normalized();

std::vector<RenderedView> PlaneViews() {
  std::vector<RenderedView> views;
  for (const Eigen::Vector3d& centre :
       {Eigen::Vector3d(0, 0, 0), {-1, 0, 0}, {1, 0.2, 0.1}, {0.1, 1, 0}}) {
    views.push_back(Render(centre, PlaneSurface(kNormal, kNormal.z() * 10), 120, 90, kNormal));
  }
  return views;
}

// One block that allows all sources.
FusedPoints FuseAll(const DepthView& reference, const float* normal,
                    const std::vector<DepthView>& sources, const FusionOptions& options) {
  const uint32_t allowed = (1u << sources.size()) - 1;
  return Fuse(reference, {normal}, sources, {1 << 20, 1, 1, &allowed}, options);
}

FusedPoints FuseView(const std::vector<RenderedView>& views, size_t reference,
                     FusionOptions options = {}) {
  std::vector<DepthView> sources;
  for (size_t i = 0; i < views.size(); ++i) {
    if (i != reference) sources.push_back(views[i].Depths(int(i)));
  }
  return FuseAll(views[reference].Depths(int(reference)), views[reference].normal.data(), sources,
                 options);
}

TEST(Fusion, PerfectDepthsGiveAPerfectCloud) {
  const std::vector<RenderedView> views = PlaneViews();
  const FusedPoints points = FuseView(views, 0);
  ASSERT_GT(points.pixel.size(), 0.7 * 120 * 90);
  for (size_t i = 0; i < points.pixel.size(); ++i) {
    const Eigen::Map<const Eigen::Vector3d> point(points.points[i].position);
    EXPECT_NEAR(kNormal.dot(point), kNormal.z() * 10, 1e-4);
    EXPECT_GT(
        Eigen::Map<const Eigen::Vector3f>(points.points[i].normal).cast<double>().dot(kNormal),
        0.9999);
    // On the ray of the pixel's centre: no half pixel is lost.
    const RenderedView& view = views[0];
    const Eigen::Vector2d pixel =
        (view.intrinsics * (view.rotation * point + view.translation)).hnormalized();
    EXPECT_NEAR(pixel.x(), double(points.pixel[i] % 120) + 0.5, 1e-6);
    EXPECT_NEAR(pixel.y(), double(points.pixel[i] / 120) + 0.5, 1e-6);
  }
}

TEST(Fusion, ASurfaceIsEmittedByOneView) {
  const std::vector<RenderedView> views = PlaneViews();
  size_t all = 0, owned = 0;
  FusionOptions duplicates;
  duplicates.keep_duplicates = true;
  for (size_t i = 0; i < views.size(); ++i) {
    owned += FuseView(views, i).pixel.size();
    all += FuseView(views, i, duplicates).pixel.size();
  }
  EXPECT_LT(owned, 0.6 * all);
  EXPECT_GE(owned, FuseView(views, 0, duplicates).pixel.size());
}

TEST(Fusion, ADepthThatNoOtherViewConfirmsIsDropped) {
  std::vector<RenderedView> views = PlaneViews();
  const size_t wrong = 45 * 120 + 60;
  views[0].depth[wrong] *= 1.1f;
  const FusedPoints points = FuseView(views, 0);
  EXPECT_EQ(std::count(points.pixel.begin(), points.pixel.end(), int64_t(wrong)), 0);
}

TEST(Fusion, ASourceThatMissesTheLastColumnByARoundingIsReadInsideItsWindow) {
  // The sources stand a hair to the left and above: the last pixels project to just before the
  // border.
  std::vector<RenderedView> views;
  for (double shift : {0.0, -1e-7, -2e-7}) {
    RenderedView view = Render({0, 0, 0}, PlaneSurface({0, 0, -1}, -10), 4000, 3);
    view.translation = Eigen::Vector3d(shift, shift, 0);
    views.push_back(view);
  }
  EXPECT_GT(FuseView(views, 0).pixel.size(), 4000u);
}

TEST(Fusion, AWindowGivesThePointsOfTheWhole) {
  const std::vector<RenderedView> views = PlaneViews();
  const FusedPoints whole = FuseView(views, 0);
  // The left half of the reference, as its own window.
  DepthView half = views[0].Depths(0);
  half.rectangle = {0, 0, 60, 90};
  std::vector<float> depth, normal(3 * 60 * 90);
  for (int y = 0; y < 90; ++y) {
    for (int x = 0; x < 60; ++x) {
      depth.push_back(views[0].depth[y * 120 + x]);
      for (int i = 0; i < 3; ++i) {
        normal[i * 60 * 90 + y * 60 + x] = views[0].normal[i * 120 * 90 + y * 120 + x];
      }
    }
  }
  half.depth = depth.data();
  std::vector<DepthView> sources;
  for (size_t i = 1; i < views.size(); ++i) sources.push_back(views[i].Depths(int(i)));
  const FusedPoints part = FuseAll(half, normal.data(), sources, {});

  std::set<std::array<double, 3>> of_whole, of_part;
  for (size_t i = 0; i < whole.pixel.size(); ++i) {
    if (whole.pixel[i] % 120 < 60) {
      of_whole.insert(
          {whole.points[i].position[0], whole.points[i].position[1], whole.points[i].position[2]});
    }
  }
  for (size_t i = 0; i < part.pixel.size(); ++i) {
    of_part.insert(
        {part.points[i].position[0], part.points[i].position[1], part.points[i].position[2]});
  }
  EXPECT_EQ(of_whole, of_part);
}

TEST(Fusion, APixelCountsTheSourcesOfItsBlockAlone) {
  const std::vector<RenderedView> views = PlaneViews();
  std::vector<DepthView> sources;
  for (size_t i = 1; i < views.size(); ++i) sources.push_back(views[i].Depths(int(i)));
  // Three in the left half, one in the right half: there one that agrees is enough.
  const uint32_t halves[] = {7, 2, 7, 2};
  FusionOptions options;
  options.keep_duplicates = true;
  const auto fused = [&] {
    return Fuse(views[0].Depths(0), {views[0].normal.data()}, sources, {60, 2, 2, halves}, options);
  };
  const FusedPoints points = fused();
  for (size_t i = 0; i < points.pixel.size(); ++i) {
    EXPECT_TRUE(points.pixel[i] % 120 < 60 || points.points[i].num_views == 2);
  }
  // A source of which nothing is given sees nothing.
  sources[1].depth = nullptr;
  const FusedPoints without = fused();
  for (int64_t pixel : without.pixel) EXPECT_LT(pixel % 120, 60);
  EXPECT_GT(without.pixel.size(), 0.25 * 120 * 90);
  const uint32_t unknown = 8;
  EXPECT_THROW(
      Fuse(views[0].Depths(0), {views[0].normal.data()}, sources, {200, 1, 1, &unknown}, options),
      std::invalid_argument);
  EXPECT_THROW(
      Fuse(views[0].Depths(0), {views[0].normal.data()}, sources, {60, 1, 1, halves}, options),
      std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
