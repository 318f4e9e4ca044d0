#include "synthetic/surface.h"

#include <cmath>
#include <random>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

// A square of side 10 at z = 0 around the origin, and a smaller one of side 2 at z = 3 above its
// middle.
Surface Table() {
  return Surface({{-5, -5, 0},
                  {5, -5, 0},
                  {5, 5, 0},
                  {-5, 5, 0},
                  {-1, -1, 3},
                  {1, -1, 3},
                  {1, 1, 3},
                  {-1, 1, 3}},
                 {{0, 1, 2}, {0, 2, 3}, {4, 5, 6}, {4, 6, 7}});
}

TEST(Surface, RayMeetsTheNearestTriangle) {
  const Surface table = Table();
  const RayHit top = table.Cast({0.2, 0.1, 10}, {0, 0, -1});
  EXPECT_NEAR(top.t, 7, 1e-12);
  EXPECT_GE(top.triangle, 2);
  EXPECT_NEAR(table.Cast({3, 0, 10}, {0, 0, -2}).t, 5, 1e-12);
  EXPECT_NEAR(table.Cast({0, 0, -4}, {0, 0, 1}).t, 4, 1e-12);
}

TEST(Surface, SlantedRayPassesUnderTheTableTop) {
  // From (-5, 0, 4) down to (0, 0, 0): at x = -1 it is at z = 0.8, below the top at 3.
  EXPECT_NEAR(Table().Cast({-5, 0, 4}, {5, 0, -4}).t, 1, 1e-12);
}

TEST(Surface, RayBesideTheSurfaceMeetsNothing) {
  EXPECT_EQ(Table().Cast({6, 0, 10}, {0, 0, -1}).triangle, -1);
  EXPECT_EQ(Table().Cast({0, 0, 10}, {0, 0, 1}).triangle, -1);
  EXPECT_EQ(Table().Cast({0, 0, 10}, {0, 0, -1}, 0, 6.9).triangle, -1);
}

TEST(Surface, SharedEdgesDoNotLeak) {
  // Straight at the diagonals of both squares, where two triangles meet.
  for (const double x : {-4.5, -0.5, 0.0, 0.25, 0.999, 4.0}) {
    EXPECT_GE(Table().Cast({x, x, 10}, {0, 0, -1}).triangle, 0) << x;
  }
}

TEST(Surface, SeesWhatNothingHides) {
  const Surface table = Table();
  EXPECT_FALSE(table.Sees({0, 0, 10}, {0, 0, 0}, 1e-6));
  EXPECT_TRUE(table.Sees({0, 0, 10}, {0, 0, 3}, 1e-6));
  EXPECT_TRUE(table.Sees({-5, 0, 4}, {0, 0, 0}, 1e-6));
}

TEST(Surface, DistanceToFaceEdgeAndCorner) {
  const Surface table = Table();
  EXPECT_NEAR(table.Distance({3, 3, 1.25}, 10), 1.25, 1e-12);  // face
  EXPECT_NEAR(table.Distance({8, 0, 4}, 10), 5, 1e-12);        // edge, 3-4-5
  EXPECT_NEAR(table.Distance({6, 7, -2}, 10), 3, 1e-12);       // corner, 1-2-2-3
  EXPECT_NEAR(table.Distance({0, 0, 2}, 10), 1, 1e-12);        // under the top
  EXPECT_TRUE(std::isinf(table.Distance({3, 3, 1.25}, 1.2)));
}

TEST(Surface, GridFindsWhatTryingEveryTriangleFinds) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> uniform(-1, 1);
  const auto point = [&] {
    return Eigen::Vector3d(uniform(random), uniform(random), uniform(random));
  };
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Surface::Triangle> triangles;
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d middle = 5 * point();
    for (int j = 0; j < 3; ++j) vertices.push_back(middle + point());
    triangles.emplace_back(3 * i, 3 * i + 1, 3 * i + 2);
  }
  const Surface whole(vertices, triangles);
  std::vector<Surface> single;
  for (const Surface::Triangle& t : triangles)
    single.emplace_back(vertices, std::vector<Surface::Triangle>{t});
  int hits = 0;
  for (int i = 0; i < 500; ++i) {
    const Eigen::Vector3d origin = 8 * point(), direction = point();
    double nearest = std::numeric_limits<double>::infinity(), distance = nearest;
    for (const Surface& triangle : single) {
      nearest = std::min(nearest, triangle.Cast(origin, direction).t);
      distance = std::min(distance, triangle.Distance(origin, 100));
    }
    EXPECT_EQ(whole.Cast(origin, direction).t, nearest);
    EXPECT_EQ(whole.Distance(origin, 100), distance);
    hits += std::isfinite(nearest);
  }
  EXPECT_GT(hits, 30);
}

TEST(Surface, SamplesSpreadEvenly) {
  const SurfaceSamples samples = Table().Sample(0.1, 3, {-5, -5}, {0, 5});
  EXPECT_NEAR(static_cast<double>(samples.points.size()), (50 + 2) * 100, 300);
  for (size_t i = 0; i < samples.points.size(); ++i) {
    EXPECT_LT(samples.points[i].x(), 0);
    EXPECT_NEAR(samples.normals[i].z(), 1, 1e-12);
  }
}

TEST(Surface, RefusesBrokenMeshes) {
  EXPECT_THROW(Surface({{0, 0, 0}}, {}), std::invalid_argument);
  EXPECT_THROW(Surface({{0, 0, 0}}, {{0, 0, 1}}), std::invalid_argument);
  EXPECT_THROW(Surface({{0, 0, NAN}}, {{0, 0, 0}}), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
