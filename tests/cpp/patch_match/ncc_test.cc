#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include <gtest/gtest.h>

#include "ncc_probe.h"
#include "patch_match/pyramid.h"

namespace sirpy::patch_match {
namespace {

using FillRow = decltype(&baseline::FillRowCosts);

constexpr int kWidth = 83, kHeight = 40;  // no multiple of any number of lanes
constexpr int kSourceWidth = 130, kSourceHeight = 90;
constexpr float kRho = 0.1f;

// Sines of several directions and wavelengths of 5 to 12 pixels, so that it can be sampled
// anywhere.
double Texture(double x, double y) {
  return 120 + 25 * std::sin(0.9 * x + 0.3 * y) + 25 * std::sin(0.5 * x - 0.6 * y + 1) +
         20 * std::sin(0.2 * x + 1.1 * y + 2) + 20 * std::sin(-0.7 * x + 0.4 * y + 3);
}

// A source that sees reference pixel (x, y) at a x~ + b rho: an affine map, moved along x by 10
// pixels per kRho.
class Scene {
 public:
  Scene(std::vector<double> affine, double contrast = 1, double brightness = 0)
      : Scene(affine, [=](double x, double y) { return contrast * Texture(x, y) + brightness; }) {}

  template <typename Image>
  Scene(const std::vector<double>& affine, const Image& image)
      : affine_(affine), source_(kSourceWidth * kSourceHeight), quads_(source_.size()) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        grey_.push_back(uint8_t(std::lround(Texture(affine[0] * x + affine[1] * y + affine[2] + 10,
                                                    affine[3] * x + affine[4] * y + affine[5]))));
      }
    }
    for (int y = 0; y < kSourceHeight; ++y) {
      for (int x = 0; x < kSourceWidth; ++x) {
        source_[y * kSourceWidth + x] = uint8_t(std::lround(image(x, y)));
      }
    }
    PackQuads(source_.data(), kSourceWidth, kSourceHeight, quads_.data());
    padded_ = Padded(grey_.data(), kWidth, kHeight, kPatchRadius);
    level_.grey = padded_.data();
    level_.width = kWidth;
    level_.height = kHeight;
    level_.blocks = &block_;
    level_.block_side = kWidth + kHeight;
    level_.block_columns = 1;
    level_.num_sources = 1;
    SourceLevel& source = level_.sources[0];
    source.quads = quads_.data();
    source.width = kSourceWidth;
    source.height = kSourceHeight;
    std::copy(affine.begin(), affine.end(), source.a);
    std::copy_n(std::vector<double>{0, 0, 1}.begin(), 3, source.a + 6);
    std::copy_n(std::vector<double>{10 / kRho, 0, 0}.begin(), 3, source.b);
  }

  struct Costs {
    std::vector<float> cost, variance;  // kHeight x kWidth
  };

  Costs Run(FillRow fill_row, std::vector<float> rho) const {
    std::vector<float> slope(rho.size());
    Costs costs{std::vector<float>(rho.size()), std::vector<float>(rho.size())};
    const Planes planes{rho.data(), slope.data(), slope.data(), nullptr, nullptr};
    for (int y = 0; y < kHeight; ++y) {
      fill_row(level_, KernelOptions(), planes, 0, y,
               {costs.cost.data() + y * kWidth, costs.variance.data() + y * kWidth});
    }
    return costs;
  }
  Costs Run(FillRow fill_row, float rho = kRho) const {
    return Run(fill_row, std::vector<float>(kWidth * kHeight, rho));
  }

  // The definition, in double precision; -1 where the patch leaves an image.
  double Cost(int x, int y, double rho) const {
    const KernelOptions options;
    double w = 0, r = 0, s = 0, rr = 0, ss = 0, rs = 0;
    for (int dy = -kPatchRadius; dy <= kPatchRadius; dy += kPatchStep) {
      for (int dx = -kPatchRadius; dx <= kPatchRadius; dx += kPatchStep) {
        const int px = x + dx, py = y + dy;
        if (px < 0 || py < 0 || px >= kWidth || py >= kHeight) return -1;
        const double u = affine_[0] * px + affine_[1] * py + affine_[2] + 10 * rho / kRho;
        const double v = affine_[3] * px + affine_[4] * py + affine_[5];
        if (u < 1 || v < 1 || u >= kSourceWidth - 2 || v >= kSourceHeight - 2) return -1;
        const double reference = grey_[py * kWidth + px], centre = grey_[y * kWidth + x];
        const uint8_t* at = &source_[int(v) * kSourceWidth + int(u)];
        const double fu = u - int(u), fv = v - int(v);
        const double value = (1 - fv) * ((1 - fu) * at[0] + fu * at[1]) +
                             fv * ((1 - fu) * at[kSourceWidth] + fu * at[kSourceWidth + 1]);
        const double weight =
            std::exp(-(reference - centre) * (reference - centre) /
                         (2 * options.color_sigma * options.color_sigma) -
                     (dx * dx + dy * dy) / (2 * options.space_sigma * options.space_sigma));
        w += weight;
        r += weight * reference;
        s += weight * value;
        rr += weight * reference * reference;
        ss += weight * value * value;
        rs += weight * reference * value;
      }
    }
    return 1 - (rs - r * s / w) / std::sqrt((rr - r * r / w) * (ss - s * s / w));
  }

 private:
  std::vector<double> affine_;
  std::vector<uint8_t> grey_, padded_, source_;
  std::vector<uint32_t> quads_;
  Block block_{1, 0.01f, 1};
  Level level_;
};

const std::vector<double> kTurned = {0.9, -0.4, 24.3, 0.5, 1.1, 7.6};

TEST(NccCost, IsTheDefinition) {
  const Scene scene(kTurned, 0.7, 30);
  for (const float rho : {0.1f, 0.1013f, 0.113f, 0.15f}) {
    const std::vector<float> cost = scene.Run(baseline::FillRowCosts, rho).cost;
    double squares = 0;
    int count = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double expected = scene.Cost(x, y, rho);
        if (expected < 0) continue;
        ASSERT_NEAR(cost[y * kWidth + x], expected, 0.01) << x << " " << y << " " << rho;
        squares += std::pow(cost[y * kWidth + x] - expected, 2);
        ++count;
      }
    }
    ASSERT_GT(count, 1000);
    EXPECT_LT(std::sqrt(squares / count), 0.001) << rho;
  }
}

// A mean error of the positions, or of the weights, would move the minimum of the cost.
TEST(NccCost, MinimumIsThatOfTheDefinition) {
  const Scene scene({1.013, 0.017, 21.5, -0.014, 1.019, 6.5});
  // In pixels from the truth, of the parabola through the mean costs a quarter pixel to both sides.
  const auto minimum = [](const auto& mean_cost) {
    const double left = mean_cost(-0.25), middle = mean_cost(0), right = mean_cost(0.25);
    return 0.25 / 2 * (left - right) / (left - 2 * middle + right);
  };
  const auto mean = [](const auto& cost) {
    double sum = 0;
    int count = 0;
    for (int y = 8; y < kHeight - 8; ++y) {
      for (int x = 8; x < kWidth - 8; ++x, ++count) sum += cost(x, y);
    }
    return sum / count;
  };
  const double found = minimum([&](double shift) {
    const auto cost = scene.Run(baseline::FillRowCosts, kRho * float(1 + shift / 10)).cost;
    return mean([&](int x, int y) { return cost[y * kWidth + x]; });
  });
  const double expected = minimum([&](double shift) {
    return mean([&](int x, int y) { return scene.Cost(x, y, kRho * (1 + shift / 10)); });
  });
  EXPECT_NEAR(found, expected, 0.0005);
}

TEST(NccCost, IsTheSameBytesOnEveryInstructionSet) {
  std::vector<float> rho;
  std::mt19937 random(3);
  for (int i = 0; i < kWidth * kHeight; ++i) {
    rho.push_back(std::uniform_real_distribution<float>(-0.05f, 0.9f)(random));
  }
  for (const Scene& scene : {Scene(kTurned), Scene({1.7, 0.2, -3, 0.1, 1.6, -2})}) {
    const Scene::Costs expected = scene.Run(baseline::FillRowCosts, rho);
    EXPECT_GT(std::count(expected.cost.begin(), expected.cost.end(), kWorstCost), 100);
#ifdef SIRPY_X86
    const auto check = [&](FillRow fill_row) {
      const Scene::Costs costs = scene.Run(fill_row, rho);
      EXPECT_EQ(costs.cost, expected.cost);
      EXPECT_EQ(costs.variance, expected.variance);
    };
    if (__builtin_cpu_supports("avx2")) check(avx2::FillRowCosts);
    if (__builtin_cpu_supports("avx512bw")) check(avx512::FillRowCosts);
#endif
  }
}

TEST(NccCost, FlatPatchesCannotBeCompared) {
  const Scene scene(kTurned, [](double, double) { return 255; });
  const std::vector<float> cost = scene.Run(baseline::FillRowCosts).cost;
  EXPECT_EQ(cost[20 * kWidth + 40], 1);
}

TEST(NccCost, BlackAndWhiteDoNotOverflow) {
  const auto stripes = [](double x, double) { return int(x) / 4 % 2 == 0 ? 0 : 255; };
  const Scene scene({1, 0, 20, 0, 1, 8}, stripes);
  const std::vector<float> cost = scene.Run(baseline::FillRowCosts).cost;
  for (int x = 10; x < 70; ++x) {
    EXPECT_NEAR(cost[20 * kWidth + x], scene.Cost(x, 20, kRho), 0.01) << x;
  }
}

TEST(WarpPatch, RefusesPatchesThatReachTooFar) {
  // 4 pixels of the reference are 12 and 20 of the source; the area is less than 4 times as large.
  const auto cost = [](double stretch) {
    return Scene({stretch, 0, 60 - 40 * stretch, 0, 0.7, 20}).Run(baseline::FillRowCosts).cost;
  };
  EXPECT_LT(cost(3)[20 * kWidth + 40], 1);
  EXPECT_EQ(cost(5)[20 * kWidth + 40], kWorstCost);
}

}  // namespace
}  // namespace sirpy::patch_match
