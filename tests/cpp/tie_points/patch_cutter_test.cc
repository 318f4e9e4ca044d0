#include "tie_points/patch_cutter.h"

#include <algorithm>
#include <array>
#include <random>
#include <stdexcept>
#include <vector>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

std::vector<uint8_t> RandomBytes(int64_t count) {
  std::mt19937 random(1);
  std::vector<uint8_t> bytes(count);
  for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random());
  return bytes;
}

TEST(PatchCutter, CutsOverlappingSquaresFromRowsInAnyPortions) {
  const ImageShape shape{50, 40, 3, 1};
  const std::vector<uint8_t> image = RandomBytes(shape.RowBytes() * shape.height);
  const std::vector<std::array<int64_t, 2>> origins = {{30, 20}, {0, 5}, {3, 7}, {43, 33}, {0, 5}};
  const int side = 7;
  for (const int64_t portion : {1, 3, 40}) {
    PatchCutter cutter(shape, origins, side);
    EXPECT_EQ(cutter.first_row(), 5);
    EXPECT_EQ(cutter.end_row(), 40);
    for (int64_t y = cutter.first_row(); !cutter.Done(); y += portion) {
      cutter.Push(&image[y * shape.RowBytes()], std::min(portion, shape.height - y));
    }
    const std::vector<uint16_t> patches = cutter.TakePatches();
    ASSERT_EQ(patches.size(), origins.size() * side * side);
    for (size_t i = 0; i < origins.size(); ++i) {
      for (int y = 0; y < side; ++y) {
        for (int x = 0; x < side; ++x) {
          const uint8_t* pixel =
              &image[(origins[i][1] + y) * shape.RowBytes() + (origins[i][0] + x) * 3];
          const double luma = 256 * (0.299 * pixel[0] + 0.587 * pixel[1] + 0.114 * pixel[2]);
          EXPECT_NEAR(patches[(i * side + y) * side + x], luma, 8);
        }
      }
    }
  }
}

TEST(PatchCutter, SixteenBitSamplesStayWhole) {
  const ImageShape shape{8, 8, 1, 2};
  std::vector<uint16_t> image(64);
  for (size_t i = 0; i < image.size(); ++i) image[i] = static_cast<uint16_t>(1023 * i);
  PatchCutter cutter(shape, {{2, 1}}, 3);
  cutter.Push(reinterpret_cast<const uint8_t*>(&image[8]), 7);
  const std::vector<uint16_t> patch = cutter.TakePatches();
  EXPECT_EQ(patch[0], image[8 + 2]);
  EXPECT_EQ(patch[8], image[3 * 8 + 4]);
}

TEST(PatchCutter, RefusesSquaresBeyondThePhotographAndMissingRows) {
  const ImageShape shape{20, 20, 1, 1};
  EXPECT_THROW(PatchCutter(shape, {{15, 0}}, 6), std::invalid_argument);
  EXPECT_THROW(PatchCutter(shape, {{0, -1}}, 6), std::invalid_argument);
  PatchCutter cutter(shape, {{0, 0}}, 6);
  EXPECT_THROW(cutter.TakePatches(), std::logic_error);
  PatchCutter nothing(shape, {}, 6);
  EXPECT_TRUE(nothing.Done());
  EXPECT_TRUE(nothing.TakePatches().empty());
}

}  // namespace
}  // namespace sirpy
