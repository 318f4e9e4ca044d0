#include "depth_filter.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/LU>

namespace sirpy {
namespace {

// Letters are depths of islands: '.' none, 'a' 10, 'b' 20, and so on.
std::vector<float> Depths(const std::vector<std::string>& rows) {
  std::vector<float> depth;
  for (const std::string& row : rows) {
    for (const char letter : row) depth.push_back(letter == '.' ? 0.f : 10.f * (letter - 'a' + 1));
  }
  return depth;
}

// A window of planes that face the camera; a pixel's worth of depth is 1 % of it.
PlaneMap Facing(const std::vector<float>& depth, std::vector<float>& normal, int64_t width) {
  const int64_t area = int64_t(depth.size());
  normal.assign(3 * area, 0);
  std::fill(normal.begin() + 2 * area, normal.end(), -1.f);
  Eigen::Matrix3d intrinsics;
  intrinsics << 100, 0, 3, 0, 100, 2, 0, 0, 1;
  return {{0, 0, width, area / width}, intrinsics, depth.data(), normal.data()};
}

// 'x' for each pixel of a speckle.
std::vector<std::string> Speckles(const std::vector<std::string>& rows, int64_t min_pixels,
                                  double step = 1) {
  const std::vector<float> depth = Depths(rows);
  std::vector<float> normal;
  const int64_t width = int64_t(rows[0].size());
  const std::vector<uint8_t> speckle =
      FindSpeckles(Facing(depth, normal, width), {step, 0, min_pixels});
  std::vector<std::string> found;
  for (size_t y = 0; y < rows.size(); ++y) {
    std::string row;
    for (int64_t x = 0; x < width; ++x) row += speckle[y * width + x] ? 'x' : '.';
    found.push_back(row);
  }
  return found;
}

using Rows = std::vector<std::string>;

TEST(FindSpeckles, SmallIslandsOfOtherDepth) {
  EXPECT_EQ(Speckles({"aaaaaaa",  //
                      "abbaaaa",  //
                      "abaacca",  //
                      "aaaacca",  //
                      "aaaaaaa"},
                     4),
            (Rows{".......",  //
                  ".xx....",  //
                  ".x.....",  //
                  ".......",  //
                  "......."}));
}

TEST(FindSpeckles, CornersDoNotConnect) {
  const Rows rows = {"......",  //
                     ".aa...",  //
                     "...aa.",  //
                     "......"};
  EXPECT_EQ(Speckles(rows, 3), (Rows{"......", ".xx...", "...xx.", "......"}));
  EXPECT_EQ(Speckles(rows, 2), (Rows{"......", "......", "......", "......"}));
}

TEST(FindSpeckles, WhatTouchesTheBorderIsLarge) {
  EXPECT_EQ(Speckles({"a...b",  //
                      "..c.b",  //
                      ".....",  //
                      ".d..."},
                     9),
            (Rows{".....", "..x..", ".....", "....."}));
}

TEST(FindSpeckles, ArmsThatMeetLateAreOneIsland) {
  const Rows rows = {".......",  //
                     ".a.a.a.",  //
                     ".a.a.a.",  //
                     ".aaaaa.",  //
                     "......."};
  EXPECT_EQ(Speckles(rows, 11), Rows(5, "......."));
  EXPECT_EQ(Speckles(rows, 12), (Rows{".......", ".x.x.x.", ".x.x.x.", ".xxxxx.", "......."}));
}

TEST(FindSpeckles, StepsAreCountedFromBothSides) {
  // 10 -> 20 is 100 pixels' worth of the first plane, 50 of the second; 20 -> 30 is 50 and 33.
  const Rows rows = {".....", ".abc.", "....."};
  EXPECT_EQ(Speckles(rows, 3, 101)[1], ".....");
  EXPECT_EQ(Speckles(rows, 3, 60)[1], ".xxx.");
  EXPECT_EQ(Speckles(rows, 2, 60)[1], ".x...");
  EXPECT_EQ(Speckles(rows, 2, 40)[1], ".xxx.");
}

// A slanted plane, exact, in a window away from the principal point, and its own normals.
struct Slant {
  PlaneMap map;
  std::vector<float> depth, normal;

  explicit Slant(const Eigen::Vector3d& n) : depth(320), normal(960) {
    map.window = {100, 50, 20, 16};
    map.intrinsics << 400, 0, 40, 0, 380, 90, 0, 0, 1;
    map.depth = depth.data();
    map.normal = normal.data();
    for (int64_t y = 0; y < 16; ++y) {
      for (int64_t x = 0; x < 20; ++x) {
        const Eigen::Vector3d ray =
            map.intrinsics.inverse() * Eigen::Vector3d(100 + x + 0.5, 50 + y + 0.5, 1);
        depth[y * 20 + x] = float(-10 / n.dot(ray));
        for (int i = 0; i < 3; ++i) normal[i * 320 + y * 20 + x] = float(n[i]);
      }
    }
  }
};

TEST(FindSpeckles, ASteepWallIsNoSpeckle) {
  Slant wall(Eigen::Vector3d(4, 0, -1).normalized());  // 4 pixels' worth from pixel to pixel
  for (int64_t i = 0; i < 320; ++i) {
    const int64_t x = i % 20, y = i / 20;
    if (x < 5 || x > 9 || y < 5 || y > 9) wall.depth[i] = 0;  // an island of 25
  }
  EXPECT_EQ(FindSpeckles(wall.map, {0.1, 0, 25}), std::vector<uint8_t>(320, 0));
  const std::vector<uint8_t> speckle = FindSpeckles(wall.map, {0.1, 0, 26});
  EXPECT_EQ(std::count(speckle.begin(), speckle.end(), 1), 25);
}

TEST(FindSpeckles, UnsureDepthsReachFarther) {
  // An island of 3 depths, 5 % or 5 pixels' worth behind what is around it.
  const int64_t width = 7, height = 5;
  std::vector<float> depth(width * height, 10.f), normal, sigma(depth.size(), 0.1f);
  const std::vector<int64_t> island = {2 * width + 2, 2 * width + 3, 2 * width + 4};
  for (const int64_t pixel : island) depth[pixel] = 10.5f;
  PlaneMap map = Facing(depth, normal, width);
  const auto count = [&](const SpeckleOptions& options) {
    const std::vector<uint8_t> speckle = FindSpeckles(map, options);
    return std::count(speckle.begin(), speckle.end(), 1);
  };
  EXPECT_EQ(count({1.5, 3, 4}), 3);  // without sigma all depths are exact
  map.sigma = sigma.data();
  EXPECT_EQ(count({1.5, 3, 4}), 3);  // 0.5 is 3.5 standard deviations of the difference, 0.14
  EXPECT_EQ(count({1.5, 4, 4}), 0);
  EXPECT_EQ(count({1.5, 0, 4}), 3);
  EXPECT_EQ(count({6, 0, 4}), 0);
  for (const int64_t pixel : island) sigma[pixel] = 0.2f;  // one side alone: sqrt(0.1^2 + 0.2^2)
  EXPECT_EQ(count({1.5, 3, 4}), 0);
}

TEST(FindSpeckles, SaysWhatCannotBe) {
  const std::vector<float> depth = {1};
  std::vector<float> normal;
  PlaneMap map = Facing(depth, normal, 1);
  EXPECT_THROW(FindSpeckles(map, {-0.1, 0, 3}), std::invalid_argument);
  EXPECT_THROW(FindSpeckles(map, {0, -1, 3}), std::invalid_argument);
  EXPECT_THROW(FindSpeckles(map, {0, 0, -1}), std::invalid_argument);
  EXPECT_EQ(FindSpeckles(map, {0, 0, 5}), (std::vector<uint8_t>{0}));
  map.window = {0, 0, int64_t(1) << 20, int64_t(1) << 20};
  EXPECT_THROW(FindSpeckles(map, {}), std::invalid_argument);
  EXPECT_THROW(CoplanarShares(map), std::invalid_argument);
  map.window = {0, 0, 0, 0};
  EXPECT_TRUE(FindSpeckles(map, {}).empty());
}

TEST(CoplanarShares, APlaneIsCoplanarHoweverItIsSlanted) {
  for (const Eigen::Vector3d& n : {Eigen::Vector3d(0, 0, -1), {0.9, 0.1, -0.6}, {-0.4, 0.8, -1}}) {
    const std::vector<float> shares = CoplanarShares(Slant(n.normalized()).map);
    EXPECT_EQ(shares, std::vector<float>(320, 1));
  }
}

TEST(CoplanarShares, AWrongNormalShows) {
  // 60 degrees: a step of tan(60) = 1.7 pixels' worth per pixel, so four pixels off is above 2.
  Slant slant(Eigen::Vector3d(std::sqrt(3.0), 0, -1).normalized());
  std::fill(slant.normal.begin(), slant.normal.begin() + 640, 0.f);
  std::fill(slant.normal.begin() + 640, slant.normal.end(), -1.f);
  EXPECT_EQ(CoplanarShares(slant.map)[8 * 20 + 10], 0.25f);  // above and below
}

TEST(CoplanarShares, StepsAndHolesAreOffThePlane) {
  Slant slant(Eigen::Vector3d(0, 0, -1));
  for (int64_t i = 0; i < 320; ++i) slant.depth[i] = i % 20 < 10 ? 10.f : 10.2f;  // 8 pixels' worth
  slant.depth[8 * 20 + 5] = 0;
  const std::vector<float> shares = CoplanarShares(slant.map);
  EXPECT_EQ(shares[8 * 20 + 5], 0);
  EXPECT_EQ(shares[4 * 20 + 5], 0.875f);  // the hole is below it
  EXPECT_EQ(shares[8 * 20 + 7], 0.625f);  // three lie beyond the step
  EXPECT_EQ(shares[0], 1);                // three neighbours inside the window
  for (float& depth : slant.depth) depth = depth == 10.2f ? 10.04f : depth;  // 1.6 pixels' worth
  EXPECT_EQ(CoplanarShares(slant.map)[8 * 20 + 7], 1);
}

TEST(CoplanarShares, UnsureDepthsAreCoplanar) {
  Slant slant(Eigen::Vector3d(0, 0, -1));
  for (int64_t i = 0; i < 320; ++i) slant.depth[i] = i % 20 < 10 ? 10.f : 10.2f;  // 8 pixels' worth
  std::vector<float> sigma(320, 0.08f);  // 0.2 is 1.8 standard deviations of the difference
  EXPECT_EQ(CoplanarShares(slant.map)[8 * 20 + 7], 0.625f);
  slant.map.sigma = sigma.data();
  EXPECT_EQ(CoplanarShares(slant.map)[8 * 20 + 7], 1);
  std::fill(sigma.begin(), sigma.end(), 0.06f);
  EXPECT_EQ(CoplanarShares(slant.map)[8 * 20 + 7], 0.625f);
}

TEST(BoxMeans, OfWhatLiesInside) {
  const std::vector<float> plane = {1, 2, 3,  //
                                    4, 5, 6};
  EXPECT_EQ(BoxMeans(plane.data(), 3, 2, 0), plane);
  EXPECT_EQ(BoxMeans(plane.data(), 3, 2, 1), (std::vector<float>{3, 3.5, 4, 3, 3.5, 4}));
  EXPECT_EQ(BoxMeans(plane.data(), 3, 2, 100), std::vector<float>(6, 3.5));
  EXPECT_EQ(BoxMeans(plane.data(), 1, 1, 7), std::vector<float>{1});
  EXPECT_TRUE(BoxMeans(plane.data(), 0, 0, 3).empty());
}

TEST(BoxMeans, TheSameBytesInEveryWindow) {
  const int64_t width = 40, height = 30, radius = 7, x0 = 5, y0 = 3;
  std::vector<float> whole, part;
  for (int64_t i = 0; i < width * height; ++i) whole.push_back(std::log(1.f + float(i * 37 % 101)));
  for (int64_t y = y0; y < height; ++y) {
    part.insert(part.end(), whole.begin() + y * width + x0, whole.begin() + (y + 1) * width);
  }
  const std::vector<float> of_whole = BoxMeans(whole.data(), width, height, radius);
  const std::vector<float> of_part = BoxMeans(part.data(), width - x0, height - y0, radius);
  for (int64_t y = y0 + radius; y < height; ++y) {
    for (int64_t x = x0 + radius; x < width; ++x) {
      EXPECT_EQ(of_whole[y * width + x], of_part[(y - y0) * (width - x0) + x - x0]);
    }
  }
}

}  // namespace
}  // namespace sirpy
