#include "patch_match/initialise.h"

#include <gtest/gtest.h>

namespace sirpy::patch_match {
namespace {

const Block kBlock{1, 0.05f, 0.2f};

Level MakeLevel(int number, int x0, int y0, int width, int height) {
  Level level;
  level.x0 = x0;
  level.y0 = y0;
  level.width = width;
  level.height = height;
  const float scale = 1.f / float(1 << number);
  level.fx = level.fy = 400 * scale;
  level.cx = 103 * scale - 0.5f;
  level.cy = 77 * scale - 0.5f;
  level.blocks = &kBlock;
  level.block_side = 1 << 20;
  level.block_columns = 1;
  level.seed = 7;
  return level;
}

struct Row {
  explicit Row(int width) : rho(width), gx(width), gy(width), views(width) {}
  Planes View() { return {rho.data(), gx.data(), gy.data(), nullptr, views.data()}; }
  std::vector<float> rho, gx, gy;
  std::vector<uint32_t> views;
};

// Inverse depth of a plane at a position of level 0 (pixel centres at whole numbers).
double PlaneRho(double x, double y) { return 0.1 + 2e-4 * x - 1e-4 * y; }

// Maps of the plane PlaneRho over a rectangle of level 0 or 1.
struct Maps {
  Maps(int level, Rectangle rectangle) {
    const size_t area = size_t(rectangle.Area());
    const Level native = MakeLevel(0, 0, 0, 1, 1);
    // The normal of the plane is along K^T m: (fx gx, fy gy, rho at the principal point), towards
    // us.
    const Eigen::Vector3d normal =
        -Eigen::Vector3d(native.fx * 2e-4, native.fy * -1e-4, PlaneRho(native.cx, native.cy))
             .normalized();
    for (size_t at = 0; at < area; ++at) {
      // A pixel of level 1 covers the native pixels 2x and 2x + 1: its centre is at 2x + 1/2.
      const auto centre = [&](int64_t pixel) { return level == 0 ? pixel : 2 * pixel + 0.5; };
      const double x = centre(rectangle.x0 + int64_t(at) % rectangle.width);
      const double y = centre(rectangle.y0 + int64_t(at) / rectangle.width);
      depth.push_back(float(1 / PlaneRho(x, y)));
      views.push_back(uint32_t(at));
    }
    for (int i = 0; i < 3; ++i) normals.insert(normals.end(), area, float(normal[i]));
    start = {level, rectangle, depth.data(), normals.data(), views.data()};
  }
  std::vector<float> depth, normals;
  std::vector<uint32_t> views;
  StartMaps start;
};

TEST(StartPlanes, AllFourCandidatesOfACoarserLevelContinueAPlaneExactly) {
  const Level fine = MakeLevel(0, 8, 16, 12, 10);
  const Maps maps(1, {3, 7, 8, 7});
  const StartPlanes source(fine, maps.start, true);
  ASSERT_EQ(source.num_candidates(), 4);
  Row row(fine.width);
  for (int y = 0; y < fine.height; ++y) {
    for (int candidate = 0; candidate < 4; ++candidate) {
      source.FillRow(y, candidate, row.View());
      for (int x = 0; x < fine.width; ++x) {
        EXPECT_NEAR(row.rho[x], PlaneRho(fine.x0 + x, fine.y0 + y), 1e-7);
        EXPECT_NEAR(row.gx[x], 2e-4, 1e-8);
        EXPECT_NEAR(row.gy[x], -1e-4, 1e-8);
      }
    }
  }
  // Native pixel (8, 17) is in pixel (4, 8) of level 1; its other neighbours are (3, ...) and
  // (..., 9).
  source.FillRow(1, 0, row.View());
  EXPECT_EQ(row.views[0], 1u * 8 + 1);
  source.FillRow(1, 3, row.View());
  EXPECT_EQ(row.views[0], 2u * 8 + 0);
}

TEST(StartPlanes, OfTheSameLevelAreThePixelsOwn) {
  const Level level = MakeLevel(0, 40, 24, 9, 7);
  Maps maps(0, {39, 22, 20, 20});
  maps.depth[2 * 20 + 4] = 0;
  const StartPlanes source(level, maps.start, false);
  ASSERT_EQ(source.num_candidates(), 1);
  Row row(level.width);
  source.FillRow(0, 0, row.View());
  EXPECT_EQ(row.rho[3], 0);
  for (int x = 4; x < level.width; ++x) {
    EXPECT_NEAR(row.rho[x], PlaneRho(level.x0 + x, level.y0), 1e-7);
    EXPECT_NEAR(row.gx[x], 2e-4, 1e-8);
    EXPECT_NEAR(row.gy[x], -1e-4, 1e-8);
    EXPECT_EQ(row.views[x], uint32_t(2 * 20 + 1 + x));
  }
}

TEST(RandomPlanes, DependOnTheNativePixelAndNotOnTheWindow) {
  const Level whole = MakeLevel(2, 0, 0, 40, 30), part = MakeLevel(2, 16, 8, 20, 20);
  const RandomPlanes of_whole(whole, {}, 0.25), of_part(part, {}, 0.25);
  Row long_row(whole.width), short_row(part.width);
  for (int candidate = 0; candidate < of_whole.num_candidates(); ++candidate) {
    of_whole.FillRow(8 + 5, candidate, long_row.View());
    of_part.FillRow(5, candidate, short_row.View());
    for (int x = 0; x < part.width; ++x) {
      EXPECT_EQ(short_row.rho[x], long_row.rho[16 + x]);
      EXPECT_EQ(short_row.gx[x], long_row.gx[16 + x]);
      EXPECT_GE(short_row.rho[x], kBlock.min_inverse_depth);
      EXPECT_LE(short_row.rho[x], kBlock.max_inverse_depth);
    }
  }
}

TEST(RandomPlanes, SeedsDoNotDependOnTheWindow) {
  const Level whole = MakeLevel(2, 0, 0, 40, 30), part = MakeLevel(2, 6, 2, 20, 20);
  const std::vector<SparsePoint> points = {{20, 20, 10}, {60, 40, 8}, {100, 90, 6}, {140, 30, 15}};
  const RandomPlanes of_whole(whole, points, 0.25), of_part(part, points, 0.25);
  Row long_row(whole.width), short_row(part.width);
  for (int y = 0; y < part.height; ++y) {
    of_whole.FillRow(2 + y, 0, long_row.View());
    of_part.FillRow(y, 0, short_row.View());
    for (int x = 0; x < part.width; ++x) EXPECT_EQ(short_row.rho[x], long_row.rho[6 + x]);
  }
}

TEST(RandomPlanes, HalfOfTheCandidatesStartNearTheNearestSparsePoint) {
  const Level level = MakeLevel(2, 0, 0, 40, 30);
  // Native pixel (20, 20) at depth 10; (140, 100) at depth 6.
  const RandomPlanes source(level, {{20, 20, 10}, {140, 100, 6}}, 0.25);
  Row row(level.width);
  source.FillRow(4, 0, row.View());
  EXPECT_NEAR(row.rho[4], 0.1, 0.15 / 16 + 1e-6);
  source.FillRow(25, 1, row.View());
  EXPECT_NEAR(row.rho[35], 1 / 6.0, 0.15 / 16 + 1e-6);
}

}  // namespace
}  // namespace sirpy::patch_match
