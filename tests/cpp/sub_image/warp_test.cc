#include "sub_image/warp.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "instruction_sets.h"
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
                            const std::vector<uint8_t>& pixels, int64_t block = 10,
                            Interpolation interpolation = Interpolation::kBilinear) {
  std::vector<uint8_t> out;
  const Rectangle window{0, 0, lens->width(), lens->height()};
  const ImageShape target{window.width, window.height, source.channels, source.sample_bytes};
  Warp warp(lens, window, source, interpolation, std::make_unique<Collect>(target, &out));
  const int64_t skipped = warp.first_row() * source.RowBytes();
  const std::vector<uint8_t> needed(pixels.begin() + skipped, pixels.end());
  PushAll(warp,
          {source.width, source.height - warp.first_row(), source.channels, source.sample_bytes},
          needed, block);
  return out;
}

// The same pixels with 16 bits: times 257, so that white stays white.
std::vector<uint8_t> Deepened(const std::vector<uint8_t>& pixels) {
  std::vector<uint8_t> deep;
  for (uint8_t value : pixels) deep.insert(deep.end(), 2, value);
  return deep;
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

TEST(Warp, WindowsArePartsOfTheWhole) {
  const ImageShape source{90, 300, 3};
  const std::vector<uint8_t> pixels = Noise(source);
  const auto lens = Affine(85, 280, 1.02, 0.3, 0.9, 2.2, 0.4);
  const std::vector<uint8_t> whole = Warped(lens, source, pixels);
  for (const Rectangle& window :
       {Rectangle{0, 0, 85, 1}, Rectangle{84, 279, 1, 1}, Rectangle{13, 100, 40, 77}}) {
    std::vector<uint8_t> out;
    Warp warp(lens, window, source, Interpolation::kBilinear,
              std::make_unique<Collect>(ImageShape{window.width, window.height, 3}, &out));
    for (int64_t y = warp.first_row(); !warp.Done(); ++y) warp.Push(&pixels[y * 270], 1);
    ASSERT_EQ(out.size(), static_cast<size_t>(window.Area() * 3));
    for (int64_t y = 0; y < window.height; ++y) {
      const uint8_t* row = &out[y * window.width * 3];
      ASSERT_TRUE(
          std::equal(row, row + window.width * 3, &whole[((window.y0 + y) * 85 + window.x0) * 3]));
    }
  }
}

TEST(Warp, EveryInterpolationKeepsFlatColourAndWholePixels) {
  const ImageShape source{40, 50, 3};
  const std::vector<uint8_t> noise = Noise(source);
  const std::vector<uint8_t> flat(noise.size(), 201);
  for (Interpolation interpolation : {Interpolation::kNearest, Interpolation::kBilinear,
                                      Interpolation::kBicubic, Interpolation::kLanczos}) {
    const std::vector<uint8_t> bent =
        Warped(Affine(30, 40, 1.013, 1.3, 0.97, 2.2, 0.05), source, flat, 7, interpolation);
    EXPECT_EQ(bent, std::vector<uint8_t>(30 * 40 * 3, 201));
    const std::vector<uint8_t> moved =
        Warped(Affine(30, 40, 1, 4, 1, 7), source, noise, 7, interpolation);
    for (int64_t y = 0; y < 40; ++y) {
      ASSERT_TRUE(std::equal(&moved[y * 90], &moved[y * 90] + 90, &noise[(y + 7) * 120 + 12]));
    }
  }
}

TEST(Warp, BicubicOfAParabolaIsExact) {
  // Catmull-Rom reproduces polynomials of degree 2: x^2 at x + 1/4, here of column i.
  const ImageShape source{12, 6, 1};
  std::vector<uint8_t> pixels;
  for (int i = 0; i < 72; ++i) pixels.push_back(static_cast<uint8_t>((i % 12) * (i % 12)));
  const std::vector<uint8_t> out =
      Warped(Affine(6, 2, 1, 2.25, 1, 2), source, pixels, 1, Interpolation::kBicubic);
  for (int i = 0; i < 6; ++i) {
    EXPECT_EQ(out[i], std::lround((i + 2.25) * (i + 2.25))) << i;
  }
}

TEST(Warp, LanczosTakesHalfAPixelBySixWeights) {
  // sinc(k + 1/2) sinc((k + 1/2) / 3) of the six neighbours, normalised: hand-computed.
  const ImageShape source{8, 8, 1};
  std::vector<uint8_t> pixels(64, 0);
  for (int y = 0; y < 8; ++y) pixels[y * 8 + 3] = 200;
  const std::vector<uint8_t> out =
      Warped(Affine(3, 1, 1, 2.5, 1, 3), source, pixels, 8, Interpolation::kLanczos);
  // Weights of a pixel half, and three halves, away: 0.6079, -0.1351 of 0.9966.
  EXPECT_EQ(out, (std::vector<uint8_t>{122, 122, 0}));
}

TEST(Warp, SixteenBitsAreThoseOfEightScaled) {
  const ImageShape source{40, 50, 3};
  const ImageShape deep{40, 50, 3, 2};
  const std::vector<uint8_t> noise = Noise(source);
  const auto lens = Affine(30, 40, 1.013, 1.3, 0.97, 2.2, 0.05);
  for (Interpolation interpolation : {Interpolation::kNearest, Interpolation::kBilinear,
                                      Interpolation::kBicubic, Interpolation::kLanczos}) {
    const std::vector<uint8_t> bytes = Warped(lens, source, noise, 9, interpolation);
    const std::vector<uint8_t> words = Warped(lens, deep, Deepened(noise), 9, interpolation);
    const uint16_t* values = reinterpret_cast<const uint16_t*>(words.data());
    for (size_t i = 0; i < bytes.size(); ++i) ASSERT_NEAR(values[i] / 257.0, bytes[i], 0.503);
  }
}

class WarpInstructionSets : public testing::TestWithParam<const char*> {};

TEST_P(WarpInstructionSets, GiveTheBytesOfTheBaseline) {
  if (!HasInstructionSet(GetParam())) GTEST_SKIP() << "this processor has no " << GetParam();
  for (const int channels : {1, 3}) {
    const ImageShape source{290, 60, channels};
    const std::vector<uint8_t> noise = Noise(source);
    // No, one and several whole vectors of pixels, and what is left over.
    for (const int64_t width : {1, 2, 15, 17, 63, 64, 65, 127, 181, 255, 280}) {
      const auto lens = Affine(width, 50, 1.013, 1.3, 0.97, 2.2, 0.05);
      for (const Interpolation interpolation : {Interpolation::kNearest, Interpolation::kBilinear,
                                                Interpolation::kBicubic, Interpolation::kLanczos}) {
        setenv("SIRPY_ISA", "baseline", 1);
        const std::vector<uint8_t> baseline = Warped(lens, source, noise, 10, interpolation);
        setenv("SIRPY_ISA", GetParam(), 1);
        const std::vector<uint8_t> wide = Warped(lens, source, noise, 10, interpolation);
        unsetenv("SIRPY_ISA");
        EXPECT_EQ(wide, baseline) << channels << " channels, width " << width;
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Warp, WarpInstructionSets, testing::Values("avx2", "avx512"),
                         [](const auto& info) { return info.param; });

}  // namespace
}  // namespace sirpy
