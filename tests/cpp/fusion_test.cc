#include "fusion.h"

#include <algorithm>
#include <random>
#include <set>
#include <string>

#include <gtest/gtest.h>

#include "instruction_sets.h"
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
  FusionOptions duplicates;
  duplicates.keep_duplicates = true;
  // Points that all four views see. Of the others every view keeps its own: where no more sources
  // see a place than must agree, none can be trusted to emit it.
  const auto count = [&](size_t i, const FusionOptions& options) {
    const FusedPoints fused = FuseView(views, i, options);
    return std::count_if(fused.points.begin(), fused.points.end(),
                         [](const FusedPoint& point) { return point.num_views == 4; });
  };
  int64_t all = 0, owned = 0;
  for (size_t i = 0; i < views.size(); ++i) {
    owned += count(i, {});
    all += count(i, duplicates);
  }
  EXPECT_LT(owned, 0.3 * double(all));
  EXPECT_GE(owned, count(0, duplicates));
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

// The depths of a view and how sure they are.
struct SureViews {
  std::vector<RenderedView> views = PlaneViews();
  std::vector<std::vector<float>> sigma;

  explicit SureViews(const std::vector<float>& sigmas) {
    for (size_t i = 0; i < views.size(); ++i) sigma.emplace_back(120 * 90, sigmas[i]);
  }
  DepthView View(size_t i) const {
    DepthView view = views[i].Depths(int(i));
    view.sigma = sigma[i].data();
    return view;
  }
  FusedPoints FuseOne(size_t reference, const FusionOptions& options,
                      const uint8_t* level = nullptr) const {
    std::vector<DepthView> sources;
    for (size_t i = 0; i < views.size(); ++i) {
      if (i != reference) sources.push_back(View(i));
    }
    const uint32_t allowed = (1u << sources.size()) - 1;
    return Fuse(View(reference), {views[reference].normal.data(), nullptr, nullptr, level}, sources,
                {1 << 20, 1, 1, &allowed}, options);
  }
  const FusedPoint* PointOf(const FusedPoints& points, int64_t pixel) const {
    const auto at = std::find(points.pixel.begin(), points.pixel.end(), pixel);
    return at == points.pixel.end() ? nullptr : &points.points[size_t(at - points.pixel.begin())];
  }
};

constexpr int64_t kMiddle = 45 * 120 + 60;

double HeightOver(const FusedPoint& point) {
  return kNormal.dot(Eigen::Map<const Eigen::Vector3d>(point.position)) - kNormal.z() * 10;
}

TEST(Fusion, SurerDepthsWeighMore) {
  // The reference is wrong by 0.4 and says so; the others are right, four times as sure.
  SureViews scene({0.4f, 0.1f, 0.1f, 0.1f});
  const auto wrong = [&](double off) {
    for (float& depth : scene.views[0].depth) depth += float(off);
  };
  FusionOptions options;
  options.keep_duplicates = true;
  options.agreement = 2.5;
  wrong(0.4);
  const FusedPoints points = scene.FuseOne(0, options);
  const FusedPoint* sure = scene.PointOf(points, kMiddle);
  ASSERT_NE(sure, nullptr);
  EXPECT_EQ(sure->num_views, 4);
  // Weights 1 and 3 times 16: 0.4 / 49 is left of it, against 0.4 / 4 of a mean.
  EXPECT_LT(std::abs(HeightOver(*sure)), 0.02);
  // As sure as one of those that agree, and not as their mean: they have mistakes in common. The
  // variance is 4 / (49 / 0.16).
  EXPECT_NEAR(sure->sigma, 0.4 * std::sqrt(4.0 / 49), 0.02);

  for (auto& sigma : scene.sigma) std::fill(sigma.begin(), sigma.end(), 0.4f);
  const FusedPoints alike = scene.FuseOne(0, options);
  ASSERT_NE(scene.PointOf(alike, kMiddle), nullptr);
  EXPECT_NEAR(std::abs(HeightOver(*scene.PointOf(alike, kMiddle))), 0.1, 0.03);
  EXPECT_NEAR(scene.PointOf(alike, kMiddle)->sigma, 0.4, 0.05);
}

TEST(Fusion, AgreementIsASmallNumberOfStandardDeviations) {
  // 0.5 off is 1.5 pixels of the sources (f B / Z^2 = 3 pixels per unit), above `consistency`.
  SureViews scene({0.2f, 0.2f, 0.2f, 0.2f});
  scene.views[0].depth[kMiddle] += 0.5f;
  FusionOptions options;
  options.keep_duplicates = true;
  options.agreement = 2.5;
  const auto is_there = [&] {
    return scene.PointOf(scene.FuseOne(0, options), kMiddle) != nullptr;
  };
  EXPECT_TRUE(is_there());  // 0.5 / sqrt(2 * 0.2^2) = 1.8
  options.agreement = 1.5;
  EXPECT_FALSE(is_there());
  options.agreement = 2.5;
  for (auto& sigma : scene.sigma) std::fill(sigma.begin(), sigma.end(), 0.05f);
  EXPECT_FALSE(is_there());  // 7
  scene.sigma[0][kMiddle] = 0.3f;
  EXPECT_TRUE(is_there());  // its own word counts
}

TEST(Fusion, MoreThanAPixelApartOneMoreMustAgree) {
  SureViews scene({0.2f, 0.2f, 0.2f, 0.2f});
  FusionOptions options;
  options.keep_duplicates = true;
  options.agreement = 2.5;
  const auto is_there = [&] {
    return scene.PointOf(scene.FuseOne(0, options), kMiddle) != nullptr;
  };
  // Two sources are enough within a pixel, three beyond.
  std::fill(scene.views[3].depth.begin(), scene.views[3].depth.end(), 0.f);
  EXPECT_TRUE(is_there());
  scene.views[0].depth[kMiddle] += 0.5f;
  EXPECT_FALSE(is_there());
}

TEST(Fusion, AsManyMustAgreeAsSeeThePlace) {
  std::vector<RenderedView> views = PlaneViews();
  views.resize(2);
  FusionOptions options;
  options.keep_duplicates = true;
  const auto count = [&] { return FuseView(views, 0, options).pixel.size(); };
  const size_t with_one = count();
  EXPECT_GT(with_one, 0.5 * 120 * 90);  // one source sees three quarters of it, and agrees
  // Sources that look elsewhere make no claims, though they are allowed.
  for (const double x : {500.0, 600.0}) {
    views.push_back(Render({x, 0, 0}, PlaneSurface(kNormal, kNormal.z() * 10), 120, 90, kNormal));
  }
  EXPECT_EQ(count(), with_one);
  // One that sees the place and has no depth there does.
  views.resize(2);
  views.push_back(views[1]);
  std::fill(views[2].depth.begin(), views[2].depth.end(), 0.f);
  EXPECT_LT(count(), 0.1 * double(with_one));
  options.min_consistent = 1;
  EXPECT_EQ(count(), with_one);
}

TEST(Fusion, AMuchSurerViewEmitsThePoint) {
  // The last view would yield to all others.
  for (const float last : {0.1f, 0.02f}) {
    const SureViews scene({0.1f, 0.1f, 0.1f, last});
    const auto is_of = [&](size_t i) {
      return scene.PointOf(scene.FuseOne(i, {}), kMiddle) != nullptr;
    };
    EXPECT_EQ(is_of(0), last == 0.1f);
    EXPECT_EQ(is_of(3), last != 0.1f);
  }
}

TEST(Fusion, NoRingOfViewsThatLeaveAPointToEachOther) {
  // Each of the last three leaves it to the next but one, which is hardly less sure, and the first
  // to the much surer last.
  const SureViews scene({1.f, 0.79f, 0.62f, 0.49f});
  size_t owned = 0;
  for (size_t i = 0; i < 4; ++i) {
    for (const FusedPoint& point : scene.FuseOne(i, {}).points) owned += point.num_views == 4;
  }
  FusionOptions duplicates;
  duplicates.keep_duplicates = true;
  size_t whole = 0;
  for (const FusedPoint& point : scene.FuseOne(0, duplicates).points) whole += point.num_views == 4;
  EXPECT_GT(owned, 0.8 * double(whole));
}

TEST(Fusion, ThinCloudsHaveAPointForEachPixelOfTheLevel) {
  const SureViews scene({0.1f, 0.1f, 0.1f, 0.1f});
  std::vector<uint8_t> level(120 * 90);
  for (size_t i = 0; i < level.size(); ++i) level[i] = i % 120 < 60 ? 2 : 0;
  FusionOptions options;
  options.keep_duplicates = true;
  const FusedPoints all = scene.FuseOne(0, options, level.data());
  options.thin = true;
  const FusedPoints thin = scene.FuseOne(0, options, level.data());
  std::set<int64_t> expected;
  for (const int64_t pixel : all.pixel) {
    const int64_t x = pixel % 120, y = pixel / 120;
    if (x >= 60 || (x % 4 == 2 && y % 4 == 2)) expected.insert(pixel);
  }
  EXPECT_EQ(std::set<int64_t>(thin.pixel.begin(), thin.pixel.end()), expected);
  for (size_t i = 0; i < thin.pixel.size(); ++i) {
    EXPECT_EQ(thin.points[i].level, thin.pixel[i] % 120 < 60 ? 2 : 0);
  }
  EXPECT_LT(thin.pixel.size(), 0.6 * double(all.pixel.size()));
}

TEST(Fusion, TheSameBytesOnEveryInstructionSet) {
  SureViews scene({0.3f, 0.1f, 0.2f, 0.05f});
  std::mt19937 random(5);
  for (size_t i = 0; i < 4; ++i) {
    for (float& depth : scene.views[i].depth)
      depth *= 0.97f + 0.06f * float(random() % 1000) / 1000;
    for (float& sigma : scene.sigma[i]) sigma *= 0.5f + float(random() % 1000) / 1000;
  }
  const auto bytes = [&] {
    const FusedPoints points = scene.FuseOne(3, {});
    const char* first = reinterpret_cast<const char*>(points.points.data());
    return std::string(first, first + points.points.size() * sizeof(FusedPoint));
  };
  const std::string expected = bytes();
  EXPECT_GT(expected.size(), 1000 * sizeof(FusedPoint));
  for (const char* set : {"baseline", "avx2", "avx512"}) {
    if (!HasInstructionSet(set)) continue;
    setenv("SIRPY_ISA", set, 1);
    EXPECT_TRUE(bytes() == expected) << set;
  }
  unsetenv("SIRPY_ISA");
}

}  // namespace
}  // namespace sirpy
