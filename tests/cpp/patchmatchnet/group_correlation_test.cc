#include "patchmatchnet/group_correlation.h"

#include <cmath>
#include <cstdlib>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "instruction_sets.h"

namespace sirpy {
namespace {

// Features that are small whole numbers: every product and sum of them is exact.
struct Map {
  int height, width, channels;
  std::vector<float> features;

  Map(int height, int width, int channels, unsigned seed)
      : height(height), width(width), channels(channels) {
    std::mt19937 random(seed);
    std::uniform_int_distribution<int> value(-8, 8);
    for (int i = 0; i < height * width * channels; ++i) features.push_back(float(value(random)));
  }

  // 0 outside.
  float At(int x, int y, int channel) const {
    if (x < 0 || y < 0 || x >= width || y >= height) return 0;
    return features[size_t(y * width + x) * channels + channel];
  }

  FeatureMap View() const { return {features.data(), height, width, channels}; }
};

// A pixel is seen moved by `shift`, at every depth.
SourceFeatures Moved(const Map& source, float shift_x, float shift_y) {
  SourceFeatures found{source.View(), {}, {float(source.width), float(source.height)}};
  found.source_from_reference << 1, 0, shift_x, 0, 0, 1, shift_y, 0, 0, 0, 1, 0;
  return found;
}

struct Case {
  Map reference, source;
  std::vector<float> depth;
  int hypotheses;
  int first_row = 0;

  // Widths with and without whole blocks, and depths at which nothing changes.
  Case(int width, int channels)
      : reference(6, width, channels, 1), source(9, width + 3, channels, 2), hypotheses(2) {
    depth.assign(size_t(hypotheses) * 6 * width, 2);
    for (size_t i = depth.size() / 2; i < depth.size(); ++i) depth[i] = 4;
  }

  std::vector<float> Run(const SourceFeatures& features, int groups) const {
    const ReferenceRows rows{reference.View(), depth.data(), hypotheses, first_row};
    return GroupCorrelation(rows, features, groups);
  }

  // sample(x, y, channel): what the source shows of a pixel.
  template <typename Sample>
  void Expect(const std::vector<float>& found, int groups, const Sample& sample) const {
    const int size = reference.channels / groups;
    ASSERT_EQ(found.size(), size_t(groups) * hypotheses * reference.height * reference.width);
    size_t at = 0;
    for (int group = 0; group < groups; ++group) {
      for (int hypothesis = 0; hypothesis < hypotheses; ++hypothesis) {
        for (int y = 0; y < reference.height; ++y) {
          for (int x = 0; x < reference.width; ++x, ++at) {
            double sum = 0;
            for (int c = group * size; c < (group + 1) * size; ++c) {
              sum += reference.At(x, y, c) * sample(x, y, c);
            }
            ASSERT_EQ(found[at], sum / size) << group << " " << hypothesis << " " << x << " " << y;
          }
        }
      }
    }
  }
};

TEST(GroupCorrelation, OfTheSamePixelIsTheMeanProductOfEachGroup) {
  for (const auto& [channels, groups] : {std::pair(16, 4), {32, 8}, {64, 8}, {64, 4}, {16, 1}}) {
    for (const int width : {1, 5, 16, 35}) {
      const Case one(width, channels);
      one.Expect(one.Run(Moved(one.source, 0, 0), groups), groups,
                 [&](int x, int y, int c) { return one.source.At(x, y, c); });
    }
  }
}

TEST(GroupCorrelation, RowsOfABandBeginAtItsFirstRow) {
  Case one(20, 16);
  one.first_row = 3;
  one.Expect(one.Run(Moved(one.source, 0, 0), 4), 4,
             [&](int x, int y, int c) { return one.source.At(x, y + 3, c); });
}

TEST(GroupCorrelation, InterpolatesBetweenPixelsAndFadesToZeroBeyondTheBorder) {
  for (const auto& [u, v] :
       {std::pair(0.5f, 0.5f), {0.25f, 0.f}, {-0.75f, 0.5f}, {-2.5f, -3.25f}, {30.5f, 0.25f}}) {
    const Case one(35, 32);
    const int left = int(std::floor(u)), top = int(std::floor(v));
    const float fu = u - left, fv = v - top;
    one.Expect(one.Run(Moved(one.source, u, v), 8), 8, [&](int x, int y, int c) {
      const auto at = [&](int dx, int dy) { return one.source.At(x + left + dx, y + top + dy, c); };
      return (1 - fv) * ((1 - fu) * at(0, 0) + fu * at(1, 0)) +
             fv * ((1 - fu) * at(0, 1) + fu * at(1, 1));
    });
  }
}

TEST(GroupCorrelation, IsZeroHoweverFarOutside) {
  const Case one(35, 32);
  for (const auto& [u, v] : {std::pair(-50.f, 0.f), {0.f, 5e9f}, {-3e20f, 3e20f}}) {
    one.Expect(one.Run(Moved(one.source, u, v), 8), 8, [](int, int, int) { return 0; });
  }
}

TEST(GroupCorrelation, DepthMovesTheRay) {
  // A source one unit to the left: u = x + 8 / depth; and z is half the depth.
  const Case one(20, 16);
  SourceFeatures features = Moved(one.source, 0, 0);
  features.source_from_reference << 0.5f, 0, 0, 4, 0, 0.5f, 0, 0, 0, 0, 0.5f, 0;
  const std::vector<float> found = one.Run(features, 4);
  const size_t plane = 6 * 20;
  for (size_t i = 0; i < 6; ++i) {
    const int x = 3 + int(i), y = int(i);
    for (const auto& [hypothesis, shift] : {std::pair(0, 4), {1, 2}}) {
      float sum = 0;
      for (int c = 4; c < 8; ++c) sum += one.reference.At(x, y, c) * one.source.At(x + shift, y, c);
      EXPECT_EQ(found[(2 + hypothesis) * plane + y * 20 + x], sum / 4);
    }
  }
}

TEST(GroupCorrelation, WhatIsBehindIsSeenWhereTheSourceSays) {
  Case one(20, 16);
  for (float& depth : one.depth) depth = &depth - one.depth.data() < 60 ? -1.f : 1e-3f;
  SourceFeatures features = Moved(one.source, 0, 0);
  one.Expect(one.Run(features, 4), 4, [](int, int, int) { return 0; });
  features.behind = {4, 7};
  one.Expect(one.Run(features, 4), 4, [&](int, int, int c) { return one.source.At(4, 7, c); });
  for (float& depth : one.depth) depth = std::nanf("");
  one.Expect(one.Run(features, 4), 4, [&](int, int, int c) { return one.source.At(4, 7, c); });
}

class GroupCorrelationSets : public testing::TestWithParam<const char*> {};

TEST_P(GroupCorrelationSets, GiveTheBytesOfTheBaseline) {
  if (!HasInstructionSet(GetParam())) GTEST_SKIP() << "this processor has no " << GetParam();
  std::mt19937 random(3);
  std::uniform_real_distribution<float> value(-1, 1);
  for (const auto& [channels, groups] : {std::pair(16, 4), {32, 8}, {64, 8}}) {
    for (const int width : {7, 16, 61}) {
      Case one(width, channels);
      for (float& feature : one.reference.features) feature = value(random);
      for (float& feature : one.source.features) feature = value(random);
      for (float& depth : one.depth) depth = 3 + 4 * value(random);
      SourceFeatures features = Moved(one.source, 0, 0);
      features.source_from_reference << 1.02f, 0.07f, -0.3f, 5, -0.04f, 0.9f, 0.4f, -3, 0.001f,
          -0.002f, 1, 0.3f;
      setenv("SIRPY_ISA", "baseline", 1);
      const std::vector<float> baseline = one.Run(features, groups);
      setenv("SIRPY_ISA", GetParam(), 1);
      const std::vector<float> wide = one.Run(features, groups);
      unsetenv("SIRPY_ISA");
      EXPECT_EQ(wide, baseline) << channels << " channels, width " << width;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(GroupCorrelation, GroupCorrelationSets, testing::Values("avx2", "avx512"),
                         [](const auto& info) { return info.param; });

TEST(GroupCorrelation, RefusesChannelsThatCannotBeGrouped) {
  const Case one(20, 16);
  const SourceFeatures features = Moved(one.source, 0, 0);
  for (const int groups : {0, -4, 3, 8, 32}) {
    EXPECT_THROW(one.Run(features, groups), std::invalid_argument) << groups;
  }
  EXPECT_THROW(Case(20, 24).Run(Moved(Map(4, 4, 24, 0), 0, 0), 3), std::invalid_argument);
  EXPECT_THROW(one.Run(Moved(Map(4, 4, 32, 0), 0, 0), 4), std::invalid_argument);
  EXPECT_THROW(one.Run(Moved(Map(0, 4, 16, 0), 0, 0), 4), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
