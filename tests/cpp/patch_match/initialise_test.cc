#include "patch_match/initialise.h"

#include <gtest/gtest.h>

namespace sirpy::patch_match {
namespace {

Level MakeLevel(int number, int x0, int y0, int width, int height) {
  Level level;
  level.level = number;
  level.x0 = x0;
  level.y0 = y0;
  level.width = width;
  level.height = height;
  const float scale = 1.f / float(1 << number);
  level.fx = level.fy = 400 * scale;
  level.cx = 103 * scale - 0.5f;
  level.cy = 77 * scale - 0.5f;
  level.min_inverse_depth = 0.05f;
  level.max_inverse_depth = 0.2f;
  level.seed = 7;
  return level;
}

struct Row {
  explicit Row(int width) : rho(width), gx(width), gy(width) {}
  Planes View() { return {rho.data(), gx.data(), gy.data(), nullptr, nullptr}; }
  std::vector<float> rho, gx, gy;
};

// Inverse depth of a plane at a position of level 0 (pixel centres at whole numbers).
double PlaneRho(double x, double y) { return 0.1 + 2e-4 * x - 1e-4 * y; }

TEST(CoarserPlanes, AllFourCandidatesContinueAPlaneExactly) {
  const Level fine = MakeLevel(0, 8, 16, 12, 10), coarse = MakeLevel(1, 4, 8, 6, 5);
  PlaneArrays planes(coarse);
  for (int y = 0; y < coarse.height; ++y) {
    for (int x = 0; x < coarse.width; ++x) {
      // A coarse pixel covers fine pixels 2x and 2x + 1: its centre is at 2x + 1/2.
      const size_t at = size_t(y) * coarse.width + x;
      planes.rho[at] = float(PlaneRho(2 * (coarse.x0 + x) + 0.5, 2 * (coarse.y0 + y) + 0.5));
      planes.gx[at] = 2 * 2e-4f;
      planes.gy[at] = 2 * -1e-4f;
    }
  }
  const CoarserPlanes source(fine, planes);
  Row row(fine.width);
  for (int y = 0; y < fine.height; ++y) {
    for (int candidate = 0; candidate < source.num_candidates(); ++candidate) {
      source.FillRow(y, candidate, row.View());
      for (int x = 0; x < fine.width; ++x) {
        EXPECT_NEAR(row.rho[x], PlaneRho(fine.x0 + x, fine.y0 + y), 1e-7);
        EXPECT_FLOAT_EQ(row.gx[x], 2e-4f);
        EXPECT_FLOAT_EQ(row.gy[x], -1e-4f);
      }
    }
  }
}

TEST(GivenPlanes, DepthAndNormalBecomeInverseDepthAndItsGradient) {
  const Level level = MakeLevel(0, 40, 24, 9, 7);
  const size_t area = size_t(level.width) * level.height;
  // The normal of the plane is along K^T m: (fx gx, fy gy, rho at the principal point), towards us.
  const double at_centre = PlaneRho(level.cx, level.cy);
  const Eigen::Vector3d normal =
      -Eigen::Vector3d(level.fx * 2e-4, level.fy * -1e-4, at_centre).normalized();
  std::vector<float> depth(area), normals(3 * area);
  for (size_t at = 0; at < area; ++at) {
    const int x = level.x0 + int(at) % level.width, y = level.y0 + int(at) / level.width;
    depth[at] = float(1 / PlaneRho(x, y));
    for (int i = 0; i < 3; ++i) normals[at + i * area] = float(normal[i]);
  }
  depth[3] = 0;
  const GivenPlanes source(level, depth.data(), normals.data());
  Row row(level.width);
  source.FillRow(0, 0, row.View());
  EXPECT_EQ(row.rho[3], 0);
  for (int x = 4; x < level.width; ++x) {
    EXPECT_NEAR(row.rho[x], PlaneRho(level.x0 + x, level.y0), 1e-7);
    EXPECT_NEAR(row.gx[x], 2e-4, 1e-8);
    EXPECT_NEAR(row.gy[x], -1e-4, 1e-8);
  }
}

TEST(RandomPlanes, DependOnTheNativePixelAndNotOnTheWindow) {
  const Level whole = MakeLevel(2, 0, 0, 40, 30), part = MakeLevel(2, 16, 8, 20, 20);
  const RandomPlanes of_whole(whole, {}), of_part(part, {});
  Row long_row(whole.width), short_row(part.width);
  for (int candidate = 0; candidate < of_whole.num_candidates(); ++candidate) {
    of_whole.FillRow(8 + 5, candidate, long_row.View());
    of_part.FillRow(5, candidate, short_row.View());
    for (int x = 0; x < part.width; ++x) {
      EXPECT_EQ(short_row.rho[x], long_row.rho[16 + x]);
      EXPECT_EQ(short_row.gx[x], long_row.gx[16 + x]);
      EXPECT_GE(short_row.rho[x], part.min_inverse_depth);
      EXPECT_LE(short_row.rho[x], part.max_inverse_depth);
    }
  }
}

TEST(RandomPlanes, SeedsDoNotDependOnTheWindow) {
  const Level whole = MakeLevel(2, 0, 0, 40, 30), part = MakeLevel(2, 6, 2, 20, 20);
  const std::vector<SparsePoint> points = {{20, 20, 10}, {60, 40, 8}, {100, 90, 6}, {140, 30, 15}};
  const RandomPlanes of_whole(whole, points), of_part(part, points);
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
  const RandomPlanes source(level, {{20, 20, 10}, {140, 100, 6}});
  Row row(level.width);
  source.FillRow(4, 0, row.View());
  EXPECT_NEAR(row.rho[4], 0.1, 0.15 / 16 + 1e-6);
  source.FillRow(25, 1, row.View());
  EXPECT_NEAR(row.rho[35], 1 / 6.0, 0.15 / 16 + 1e-6);
}

}  // namespace
}  // namespace sirpy::patch_match
