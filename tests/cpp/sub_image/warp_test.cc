#include "sub_image/warp.h"

#include <cmath>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "error.h"
#include "rows.h"

namespace sirpy {
namespace {

// position in the photograph = origin + scale * position in the undistorted image
std::shared_ptr<const LensMap> Affine(int64_t width, int64_t height, double scale_x, double x0,
                                      double scale_y, double y0, double shear = 0) {
  std::vector<double> nodes;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const double x = 0.5 + (width - 1) * column / 3.0;
      const double y = 0.5 + (height - 1) * row / 3.0;
      nodes.push_back(x0 + scale_x * x);
      nodes.push_back(y0 + scale_y * y + shear * x);
    }
  }
  return std::make_shared<LensMap>(nodes, 4, 4, width, height);
}

std::vector<uint8_t> Warped(std::shared_ptr<const LensMap> lens, const ImageShape& source,
                            const std::vector<uint8_t>& pixels, int64_t block = 10) {
  std::vector<uint8_t> out;
  const ImageShape target{lens->width(), lens->height(), source.channels};
  Warp warp(lens, source, std::make_unique<Collect>(target, &out));
  PushAll(warp, source, pixels, block);
  return out;
}

TEST(Warp, ShiftByWholePixelsCopies) {
  const ImageShape source{50, 200, 3};
  const std::vector<uint8_t> pixels = Noise(source);
  const std::vector<uint8_t> out = Warped(Affine(40, 190, 1, 4, 1, 7), source, pixels);
  ASSERT_EQ(out.size(), 40u * 190 * 3);
  for (int64_t y = 0; y < 190; ++y) {
    for (int64_t i = 0; i < 40 * 3; ++i) {
      ASSERT_EQ(out[y * 120 + i], pixels[(y + 7) * 150 + 4 * 3 + i]) << y << " " << i;
    }
  }
}

TEST(Warp, HalfPixelIsTheMean) {
  const ImageShape source{3, 2, 1};
  const std::vector<uint8_t> out =
      Warped(Affine(2, 1, 1, 0.5, 1, 0.5), source, {10, 20, 31, 50, 60, 70});
  EXPECT_EQ(out, (std::vector<uint8_t>{35, 45}));  // 140 / 4, 181 / 4
}

TEST(Warp, BeyondTheOutermostCentresIsBlack) {
  const ImageShape source{3, 3, 1};
  const std::vector<uint8_t> out =
      Warped(Affine(5, 5, 1, -1, 1, -1), source, std::vector<uint8_t>(9, 200));
  // Columns 1 and 2 of the photograph's 3 have a right neighbour to interpolate with; the last has
  // none.
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 5; ++x) {
      const bool inside = x >= 1 && x <= 2 && y >= 1 && y <= 2;
      EXPECT_EQ(out[y * 5 + x], inside ? 200 : 0) << x << " " << y;
    }
  }
}

TEST(Warp, BlocksOfAnySizeGiveTheSame) {
  const ImageShape source{90, 300, 3};
  const std::vector<uint8_t> pixels = Noise(source);
  const auto lens = Affine(85, 280, 1.02, 0.3, 0.9, 2.2, 0.4);
  const std::vector<uint8_t> whole = Warped(lens, source, pixels, 300);
  for (int64_t block : {1, 3, 64, 65, 299}) EXPECT_EQ(Warped(lens, source, pixels, block), whole);
}

TEST(Warp, PartsThatNeedNoSourceRowAreBlack) {
  const ImageShape source{20, 30, 1};
  const std::vector<uint8_t> pixels(600, 90);
  // The undistorted image reaches far above and below the photograph.
  const std::vector<uint8_t> out = Warped(Affine(20, 400, 1, -0.25, 1, -200), source, pixels);
  ASSERT_EQ(out.size(), 20u * 400);
  EXPECT_EQ(out[10], 0);
  EXPECT_EQ(out[210 * 20 + 10], 90);
  EXPECT_EQ(out[399 * 20 + 10], 0);
}

TEST(Warp, UpsideDownLensIsRefused) {
  const ImageShape source{20, 300, 1};
  EXPECT_THROW(Warped(Affine(20, 300, 1, 0, -1, 300), source, Noise(source)), InputError);
}

}  // namespace
}  // namespace sirpy
