#include "depth_filter.h"

#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

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

// 'x' for each pixel of a speckle.
std::vector<std::string> Speckles(const std::vector<std::string>& rows, int64_t min_pixels,
                                  double step = 0.01) {
  const int64_t width = int64_t(rows[0].size()), height = int64_t(rows.size());
  const std::vector<uint8_t> speckle =
      FindSpeckles(Depths(rows).data(), width, height, {step, step, min_pixels});
  std::vector<std::string> found;
  for (int64_t y = 0; y < height; ++y) {
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

TEST(FindSpeckles, StepsAreSharesOfTheNearerDepth) {
  // 10 -> 20 is a step of 1 x the nearer depth, 20 -> 30 one of 0.5.
  const Rows rows = {".....", ".abc.", "....."};
  EXPECT_EQ(Speckles(rows, 3, 1.0)[1], ".....");
  EXPECT_EQ(Speckles(rows, 3, 0.6)[1], ".xxx.");
  EXPECT_EQ(Speckles(rows, 2, 0.6)[1], ".x...");
  // Across and down have steps of their own.
  const std::vector<float> depth = Depths({"....", ".ab.", ".b..", "...."});
  const std::vector<uint8_t> speckle = FindSpeckles(depth.data(), 4, 4, {1.0, 0.5, 2});
  EXPECT_EQ(speckle, (std::vector<uint8_t>{0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0}));
}

TEST(FindSpeckles, SaysWhatCannotBe) {
  const float depth = 1;
  EXPECT_THROW(FindSpeckles(&depth, 1, 1, {-0.1, 0, 3}), std::invalid_argument);
  EXPECT_THROW(FindSpeckles(&depth, 1, 1, {0, 0, -1}), std::invalid_argument);
  EXPECT_THROW(FindSpeckles(nullptr, int64_t(1) << 20, int64_t(1) << 20, {}),
               std::invalid_argument);
  EXPECT_TRUE(FindSpeckles(nullptr, 0, 0, {}).empty());
  EXPECT_EQ(FindSpeckles(&depth, 1, 1, {0, 0, 5}), (std::vector<uint8_t>{0}));
}

}  // namespace
}  // namespace sirpy
