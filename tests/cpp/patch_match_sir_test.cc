#include "patch_match_sir.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <random>
#include <stdexcept>
#include <utility>

#include <gtest/gtest.h>

#include "instruction_sets.h"
#include "patch_match/pyramid.h"
#include "plane_scene.h"

namespace sirpy {
namespace {

constexpr int kWidth = 160, kHeight = 120;

// One block that allows four sources and depths of 7 to 14.
struct OneBlock {
  uint32_t allowed = 15;
  float min_depth = 7, max_depth = 14;
  ViewBlocks View() const { return {1 << 20, 1, 1, &allowed, &min_depth, &max_depth}; }
};

struct Scene {
  OneBlock blocks;
  RenderedView reference;
  std::vector<RenderedView> sources;

  Scene(const Surface& surface, const Eigen::Vector3d& normal = {0, 0, -1}) {
    reference = Render({0, 0, 0}, surface, kWidth, kHeight, normal);
    for (const Eigen::Vector3d& centre :
         {Eigen::Vector3d(-1.5, 0, 0), {1.5, 0.2, 0}, {0.1, 1.4, 0}, {-0.2, -1.5, 0.1}}) {
      sources.push_back(Render(centre, surface, kWidth, kHeight, normal));
    }
  }

  // Photometric passes from level levels - 1 to the native one.
  PatchMatchResult Run(PatchMatchOptions options = {}, int levels = 3) const {
    PatchMatchResult result;
    for (int level = levels - 1; level >= 0; --level) {
      options.iterations = level == levels - 1 ? 4 : 2;
      options.largest_step = level == levels - 1 ? 8 : 2;
      const int before = (kWidth >> (level + 1)), height = (kHeight >> (level + 1));
      const StartMaps start{
          level + 1,           {0, 0, before, height}, result.depth.data(), result.normal.data(),
          result.views.data(), result.sigma.data(),    result.level.data()};
      PatchMatchResult next = RunPass(level, level == levels - 1 ? nullptr : &start, options);
      result = std::move(next);
    }
    return result;
  }

  PatchMatchResult RunPass(int level, const StartMaps* start, const PatchMatchOptions& options,
                           Rectangle window = {}) const {
    std::vector<std::vector<uint8_t>> shrunk;
    const auto at_level = [&](const RenderedView& view) {
      shrunk.push_back(patch_match::Shrunk(view.grey.data(), kWidth, kHeight, 1 << level));
      ViewWindow found = view.Window();
      found.level = level;
      found.rectangle = {0, 0, kWidth >> level, kHeight >> level};
      found.grey = shrunk.back().data();
      return found;
    };
    ViewWindow of_reference = at_level(reference);
    std::vector<uint8_t> cut;
    if (window.Area() > 0) {
      for (int64_t y = window.y0; y < window.y1(); ++y) {
        const uint8_t* row = of_reference.grey + y * of_reference.rectangle.width;
        cut.insert(cut.end(), row + window.x0, row + window.x1());
      }
      of_reference.rectangle = window;
      of_reference.grey = cut.data();
    }
    std::vector<ViewWindow> windows;
    for (const RenderedView& source : sources) windows.push_back(at_level(source));
    return PatchMatchSir(of_reference, windows, blocks.View(), {{80, 60, 10}}, start, options);
  }

  // A geometric pass from the true depths.
  PatchMatchResult RunGeometric() const {
    std::vector<ViewWindow> windows;
    for (const RenderedView& source : sources) windows.push_back(source.Window(true));
    const std::vector<uint32_t> views(kWidth * kHeight, 15);
    const StartMaps start{
        0, {0, 0, kWidth, kHeight}, reference.depth.data(), reference.normal.data(), views.data()};
    return PatchMatchSir(reference.Window(), windows, blocks.View(), {}, &start, {});
  }

  // What the sources say of planes as they are.
  PatchMatchResult Judge(const std::vector<float>& depth) const {
    std::vector<ViewWindow> windows;
    for (const RenderedView& source : sources) windows.push_back(source.Window(true));
    const std::vector<uint32_t> views(kWidth * kHeight);
    const StartMaps start{
        0, {0, 0, kWidth, kHeight}, depth.data(), reference.normal.data(), views.data()};
    PatchMatchOptions options;
    options.iterations = 0;
    return PatchMatchSir(reference.Window(), windows, blocks.View(), {}, &start, options);
  }

  // Gaussian noise in every photograph, in grey levels; as in photographs that have been through a
  // colour filter, neighbours share some of it.
  void AddNoise(double deviation) {
    std::mt19937 random(7);
    std::normal_distribution<double> normal(0, deviation * 16 / 6);  // 1 2 1 leaves 6 / 16 of it
    const auto add = [&](RenderedView& view) {
      const int width = kWidth + 2;
      std::vector<double> noise(size_t(width) * (kHeight + 2));
      for (double& one : noise) one = normal(random);
      for (int y = 0; y < kHeight; ++y) {
        for (int x = 0; x < kWidth; ++x) {
          double sum = 0;
          for (int i = 0; i < 9; ++i) {
            sum += (1 + (i % 3 == 1)) * (1 + (i / 3 == 1)) * noise[(y + i / 3) * width + x + i % 3];
          }
          uint8_t& grey = view.grey[size_t(y) * kWidth + x];
          grey = uint8_t(std::lround(std::clamp(grey + sum / 16, 0.0, 255.0)));
        }
      }
    };
    add(reference);
    for (RenderedView& source : sources) add(source);
  }

  // Signed errors in pixels of motion in a source, inside a border where the sources see
  // everything.
  std::vector<double> ShiftErrors(const PatchMatchResult& result, int border = 32) const {
    std::vector<double> errors;
    for (int y = border; y < kHeight - border; ++y) {
      for (int x = border; x < kWidth - border; ++x) {
        const size_t at = size_t(y) * kWidth + x;
        errors.push_back(300 * 1.5 *
                         (1 / double(result.depth[at]) - 1 / double(reference.depth[at])));
      }
    }
    return errors;
  }
};

double Median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
  return values[values.size() / 2];
}

double MedianSize(std::vector<double> values) {
  for (double& value : values) value = std::abs(value);
  return Median(values);
}

const Eigen::Vector3d kSlanted = Eigen::Vector3d(0.45, -0.3, -1).normalized();

TEST(PatchMatchSir, SlantedPlaneIsFoundWithoutBias) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  const PatchMatchResult result = scene.Run();
  EXPECT_LT(std::abs(Median(scene.ShiftErrors(result))), 0.02);
  EXPECT_LT(MedianSize(scene.ShiftErrors(result)), 0.05);

  std::vector<double> angles;
  const size_t area = result.depth.size();
  for (size_t at = 0; at < area; ++at) {
    if (result.depth[at] == 0) continue;
    double cosine = 0;
    for (int i = 0; i < 3; ++i) {
      cosine += double(result.normal[at + i * area]) * scene.reference.normal[at + i * area];
    }
    angles.push_back(std::acos(std::min(cosine, 1.0)) * 180 / M_PI);
  }
  EXPECT_LT(Median(angles), 3);
}

TEST(PatchMatchSir, EveryPyramidLevelHasTheSamePixelCentres) {
  // A plane at constant depth: an offset of half a pixel at any level would bias the coarse answer.
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  for (int levels : {1, 2, 3}) {
    EXPECT_LT(std::abs(Median(scene.ShiftErrors(scene.Run({}, levels)))), 0.02)
        << levels << " levels";
  }
}

TEST(PatchMatchSir, StepIsSharp) {
  const Surface near = PlaneSurface({0, 0, -1}, -9), far = PlaneSurface({0, 0, -1}, -10.5);
  const Scene scene([&](const Eigen::Vector3d& centre, const Eigen::Vector3d& ray) {
    const double depth = near(centre, ray);
    return (centre + depth * ray).x() > 0 ? depth : far(centre, ray);
  });
  const PatchMatchResult result = scene.Run();
  int wrong = 0, total = 0;
  for (int y = 32; y < kHeight - 32; ++y) {
    for (int x = 60; x < 100; ++x) {
      const size_t at = size_t(y) * kWidth + x;
      wrong += std::abs(result.depth[at] - scene.reference.depth[at]) > 0.5;
      ++total;
    }
  }
  EXPECT_LT(wrong, 0.1 * total);  // 4 of the 40 columns around the step
}

TEST(PatchMatchSir, GeometricPassKeepsATrueDepthAndCountsAgreement) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  const PatchMatchResult result = scene.RunGeometric();
  EXPECT_LT(MedianSize(scene.ShiftErrors(result)), 0.05);
  EXPECT_GE(int(result.num_consistent[60 * kWidth + 80]), 4);
}

TEST(PatchMatchSir, SameBytesOnAnyNumberOfThreadsAndInstructionSet) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  PatchMatchOptions one, three;
  one.threads = 1;
  three.threads = 3;
  const PatchMatchResult expected = scene.Run(one);
  EXPECT_EQ(expected.depth, scene.Run(three).depth);
  setenv("SIRPY_ISA", "baseline", 1);
  const PatchMatchResult baseline = scene.Run(one);
  unsetenv("SIRPY_ISA");
  EXPECT_EQ(expected.depth, baseline.depth);
  EXPECT_EQ(expected.normal, baseline.normal);
  EXPECT_EQ(expected.cost, baseline.cost);
  EXPECT_EQ(expected.sigma, baseline.sigma);
  EXPECT_EQ(expected.level, baseline.level);
}

std::array<double, 16> Noise(double variance) {
  std::array<double, 16> noise;
  noise.fill(variance);
  return noise;
}

// What it promises of errors that it cannot see itself: their size, within a factor of 2.5.
TEST(PatchMatchSir, StandardDeviationsAreThoseOfTheErrors) {
  for (const double noise : {3.0, 10.0, 25.0}) {
    Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
    scene.AddNoise(noise);
    PatchMatchOptions options;
    options.noise = Noise(noise * noise);
    const PatchMatchResult result = scene.Run(options);
    std::vector<double> ratios, sizes;
    int wild = 0;
    for (int y = 32; y < kHeight - 32; ++y) {
      for (int x = 32; x < kWidth - 32; ++x) {
        const size_t at = size_t(y) * kWidth + x;
        ASSERT_GT(result.depth[at], 0);
        ASSERT_GT(result.sigma[at], 0);
        const double error = std::abs(double(result.depth[at]) - scene.reference.depth[at]);
        ratios.push_back(error / result.sigma[at]);
        sizes.push_back(error / result.motion[at]);
        wild += ratios.back() > 5;
      }
    }
    const double scale = 1.4826 * Median(ratios);  // 1 of Gaussian errors of that size
    // With so little noise the least deviation decides, of what photographs have and scenes of
    // tests have not: 0.1 pixels.
    EXPECT_GT(scale, noise > 5 ? 1 / 2.5 : 0) << noise;
    EXPECT_LT(scale, 2.5) << noise;
    EXPECT_LT(wild, 0.02 * double(ratios.size())) << noise;
    EXPECT_LT(Median(sizes), 0.5) << noise;  // pixels of motion
  }
}

TEST(PatchMatchSir, MotionIsTheDepthOfAPixel) {
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  PatchMatchOptions options;
  options.top_views = 1;
  const PatchMatchResult result = scene.Run(options);
  std::vector<double> motions;
  for (int y = 32; y < kHeight - 32; ++y) {
    for (int x = 32; x < kWidth - 32; ++x) motions.push_back(result.motion[y * kWidth + x]);
  }
  EXPECT_NEAR(Median(motions), 10.0 * 10.0 / (300 * 1.5), 0.03);  // Z^2 / (f B)
}

// Where the photographs hold nothing but noise, what is known stays, with what is known of it.
TEST(PatchMatchSir, NoiseAloneLeavesTheStartAsItIs) {
  const double noise = 4;
  Scene scene(PlaneSurface({0, 0, -1}, -10));
  const auto flatten = [](RenderedView& view) {
    std::fill(view.grey.begin(), view.grey.end(), uint8_t(120));
  };
  flatten(scene.reference);
  for (RenderedView& source : scene.sources) flatten(source);
  scene.AddNoise(noise);
  const size_t area = size_t(kWidth) * kHeight;
  const std::vector<uint32_t> views(area, 15);
  const std::vector<float> sigma(area, 0.2f);
  const std::vector<uint8_t> level(area, 3);
  StartMaps start{0,
                  {0, 0, kWidth, kHeight},
                  scene.reference.depth.data(),
                  scene.reference.normal.data(),
                  views.data(),
                  sigma.data(),
                  level.data()};
  PatchMatchOptions options;
  options.noise = Noise(1.5 * noise * noise);  // patches of noise vary less
  const PatchMatchResult held = scene.RunPass(0, &start, options);
  start.sigma = nullptr;
  start.level_of = nullptr;
  const PatchMatchResult free = scene.RunPass(0, &start, options);
  int kept = 0, of_start = 0, wandered = 0, total = 0;
  for (int y = 32; y < kHeight - 32; ++y) {
    for (int x = 32; x < kWidth - 32; ++x) {
      const size_t at = size_t(y) * kWidth + x;
      ++total;
      kept += std::abs(held.depth[at] - 10) < 0.2;
      of_start += held.level[at] == 3 && std::abs(held.sigma[at] - 0.2) < 0.02;
      wandered += std::abs(free.depth[at] - 10) > 0.2;
    }
  }
  EXPECT_GT(kept, 0.9 * total);
  EXPECT_GT(of_start, 0.9 * total);
  EXPECT_GT(wandered, 0.3 * total);  // otherwise this test shows nothing
}

// And where they hold more than noise, what is known less well gives way.
TEST(PatchMatchSir, TextureOverrulesAnUnsureStart) {
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  const size_t area = size_t(kWidth) * kHeight;
  const std::vector<uint32_t> views(area, 15);
  const std::vector<float> depth(area, 10.3f), sigma(area, 0.2f);
  const std::vector<uint8_t> level(area, 3);
  const StartMaps start{0,
                        {0, 0, kWidth, kHeight},
                        depth.data(),
                        scene.reference.normal.data(),
                        views.data(),
                        sigma.data(),
                        level.data()};
  const PatchMatchResult found = scene.RunPass(0, &start, {});
  EXPECT_LT(MedianSize(scene.ShiftErrors(found)), 0.05);
  int own = 0, total = 0;
  for (int y = 32; y < kHeight - 32; ++y) {
    for (int x = 32; x < kWidth - 32; ++x, ++total) {
      const size_t at = size_t(y) * kWidth + x;
      own += found.level[at] == 0 && found.sigma[at] < 0.2f;
    }
  }
  EXPECT_GT(own, 0.95 * total);
}

// 32 sources: some are not given, some look away or lie behind the surface, and their depths have
// holes. Blocks end inside groups of lanes, and some of them are not known.
TEST(PatchMatchSir, SameBytesWhateverTheSources) {
  Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  for (const unsigned seed : {0u, 1u, 2u}) {
    std::mt19937 random(seed);
    const auto uniform = [&] { return double(random()) / double(random.max()); };
    std::vector<RenderedView> views;
    for (int j = 0; j < 32; ++j) {
      views.push_back(scene.sources[j % 4]);
      RenderedView& view = views.back();
      const double turn = j % 5 == 0 ? 3 * uniform() : 0.05 * uniform();
      view.rotation = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()) * view.rotation;
      view.translation += Eigen::Vector3d::Random() * (j % 7 == 0 ? 20 : 0.1);
      for (float& rho : view.inverse_depth)
        rho *= uniform() < 0.2 ? 0 : float(0.9 + 0.2 * uniform());
    }
    std::vector<ViewWindow> windows;
    for (size_t j = 0; j < views.size(); ++j) {
      windows.push_back(j % 6 == 5 ? ViewWindow{} : views[j].Window(true));
    }
    std::vector<uint32_t> allowed;
    std::vector<float> least, most;
    for (int i = 0; i < 5 * 4; ++i) {
      allowed.push_back(i % 7 == 3 ? 0 : uint32_t(random()));
      least.push_back(allowed.back() ? 7 : 0);
      most.push_back(allowed.back() ? 14 : 0);
    }
    const ViewBlocks blocks{37, 5, 4, allowed.data(), least.data(), most.data()};
    std::vector<uint32_t> used(kWidth * kHeight);
    for (uint32_t& word : used) word = uint32_t(random() & random() & random());
    std::vector<float> deviation(kWidth * kHeight), sigma(kWidth * kHeight);
    std::vector<uint8_t> level_of(kWidth * kHeight);
    for (float& one : deviation) one = uniform() < 0.2 ? 0 : float(0.01 * uniform());
    for (float& one : sigma) one = uniform() < 0.2 ? 0 : float(0.5 * uniform());
    for (uint8_t& one : level_of) one = uint8_t(random() % 5);
    for (size_t j = 0; j < windows.size(); j += 2) {
      if (windows[j].inverse_depth) windows[j].deviation = deviation.data();
    }
    const StartMaps start{0,
                          {0, 0, kWidth, kHeight},
                          scene.reference.depth.data(),
                          scene.reference.normal.data(),
                          used.data(),
                          sigma.data(),
                          level_of.data()};
    const auto run = [&](int threads) {
      PatchMatchOptions options;
      options.threads = threads;
      options.everywhere = seed == 1;
      options.noise = Noise(seed == 2 ? 2000 : 20);
      return PatchMatchSir(scene.reference.Window(), windows, blocks, {}, &start, options);
    };
    const PatchMatchResult expected = run(1);
    EXPECT_GT(std::count_if(expected.depth.begin(), expected.depth.end(),
                            [](float depth) { return depth > 0; }),
              1000);
    const auto expect_same = [&](const PatchMatchResult& found) {
      EXPECT_EQ(expected.depth, found.depth);  // a NaN would not be equal to itself
      EXPECT_EQ(expected.normal, found.normal);
      EXPECT_EQ(expected.cost, found.cost);
      EXPECT_EQ(expected.views, found.views);
      EXPECT_EQ(expected.num_seeing, found.num_seeing);
      EXPECT_EQ(expected.num_consistent, found.num_consistent);
      EXPECT_EQ(expected.sigma, found.sigma);
      EXPECT_EQ(expected.motion, found.motion);
      EXPECT_EQ(expected.level, found.level);
    };
    expect_same(run(3));
    for (const char* set : {"baseline", "avx2", "avx512"}) {
      if (!HasInstructionSet(set)) continue;
      setenv("SIRPY_ISA", set, 1);
      expect_same(run(2));
    }
    unsetenv("SIRPY_ISA");
  }
}

TEST(PatchMatchSir, WithoutASweepPlanesAreJudgedAndLeftAsTheyAre) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  std::vector<float> depth = scene.reference.depth;
  const int border = 56;  // where all sources see the patch
  for (int x = 0; x < kWidth; ++x) {
    depth[58 * kWidth + x] *= 1.1f;  // wrong by some pixels
    depth[60 * kWidth + x] = 0;
    depth[62 * kWidth + x] = 20;  // deeper than the block allows
    depth[61 * kWidth + x] = -1;
  }
  const PatchMatchResult found = scene.Judge(depth);
  for (int y = border; y < kHeight - border; ++y) {
    for (int x = border; x < kWidth - border; ++x) {
      const size_t at = size_t(y) * kWidth + x;
      if (y >= 60 && y <= 62) {
        EXPECT_EQ(found.depth[at], 0);
        continue;
      }
      EXPECT_FLOAT_EQ(found.depth[at], depth[at]);
      EXPECT_EQ(found.num_seeing[at], 4);
      EXPECT_EQ(found.num_consistent[at], y == 58 ? 0 : 4);
      if (y == 58) {
        EXPECT_GT(found.cost[at], 0.1);
      } else {
        EXPECT_LT(found.cost[at], 0.1);
      }
    }
  }
}

TEST(PatchMatchSir, NoMoreSourcesThanAskedFor) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  PatchMatchOptions options;
  options.top_views = 1;
  for (const uint32_t views : scene.Run(options, 1).views) EXPECT_LE(__builtin_popcount(views), 1);
}

TEST(PatchMatchSir, RefusesWhatMakesNoSense) {
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  const std::vector<ViewWindow> sources = {scene.sources[0].Window()};
  const auto run = [&](const OneBlock& block, const std::vector<ViewWindow>& windows = {},
                       const StartMaps* start = nullptr) {
    PatchMatchSir(scene.reference.Window(), windows.empty() ? sources : windows, block.View(), {},
                  start, {});
  };
  EXPECT_NO_THROW(run({1}));
  EXPECT_THROW(run({3}), std::invalid_argument);  // there is no second source
  EXPECT_THROW(run({1, 9, 5}), std::invalid_argument);
  EXPECT_THROW(run({1, 0, 5}), std::invalid_argument);
  std::vector<ViewWindow> wide = sources;
  wide[0].rectangle = {0, 0, 1 << 15, 2};
  EXPECT_THROW(run({1}, wide), std::invalid_argument);
  const std::vector<uint32_t> views(kWidth * kHeight);
  StartMaps start{0,
                  {0, 0, kWidth, kHeight},
                  scene.reference.depth.data(),
                  scene.reference.normal.data(),
                  views.data()};
  EXPECT_NO_THROW(run({1}, {}, &start));
  start.rectangle.x0 = 1;
  EXPECT_THROW(run({1}, {}, &start), std::invalid_argument);
}

TEST(PatchMatchSir, WhatLiesWithinTheMarginDoesNotDependOnTheWindow) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  PatchMatchOptions options;
  options.iterations = 1;
  const PatchMatchResult whole = scene.RunPass(0, nullptr, options);
  const int margin = PatchMatchMargin(1);
  const Rectangle window{3, 5, 137, 113};  // of 160 x 120: a core of 37 x 13 pixels is left
  const PatchMatchResult part = scene.RunPass(0, nullptr, options, window);
  int compared = 0, different_outside = 0;
  for (int64_t y = 0; y < window.height; ++y) {
    for (int64_t x = 0; x < window.width; ++x) {
      const size_t in_part = size_t(y * window.width + x);
      const size_t in_whole = size_t((window.y0 + y) * kWidth + window.x0 + x);
      const bool inside =
          x >= margin && y >= margin && x < window.width - margin && y < window.height - margin;
      const bool same = part.depth[in_part] == whole.depth[in_whole] &&
                        part.cost[in_part] == whole.cost[in_whole] &&
                        part.views[in_part] == whole.views[in_whole] &&
                        part.num_seeing[in_part] == whole.num_seeing[in_whole];
      compared += inside;
      EXPECT_TRUE(same || !inside) << x << ", " << y;
      different_outside += !inside && !same;
    }
  }
  EXPECT_GE(compared, 400);
  EXPECT_GT(different_outside, 0);  // otherwise this test shows nothing
}

TEST(PatchMatchSir, ASourceAtACoarserLevelGivesTheSamePlane) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  std::vector<std::vector<uint8_t>> shrunk;
  std::vector<ViewWindow> windows;
  for (const RenderedView& source : scene.sources) {
    shrunk.push_back(patch_match::Shrunk(source.grey.data(), kWidth, kHeight, 2));
    ViewWindow window = source.Window();
    window.level = 1;
    window.rectangle = {0, 0, kWidth / 2, kHeight / 2};
    window.grey = shrunk.back().data();
    windows.push_back(window);
  }
  PatchMatchOptions options;
  options.iterations = 4;
  options.largest_step = 8;
  const PatchMatchResult result = PatchMatchSir(
      scene.reference.Window(), windows, scene.blocks.View(), {{80, 60, 10}}, nullptr, options);
  EXPECT_LT(std::abs(Median(scene.ShiftErrors(result))), 0.03);
  EXPECT_LT(MedianSize(scene.ShiftErrors(result)), 0.15);
}

TEST(PatchMatchSir, ABlockBoundsDepthsAndSources) {
  Scene scene(PlaneSurface({0, 0, -1}, -10));
  scene.blocks.allowed = 2;
  scene.blocks.min_depth = 10.5;
  const PatchMatchResult result = scene.RunPass(0, nullptr, {});
  for (size_t at = 0; at < result.depth.size(); ++at) {
    EXPECT_EQ(result.views[at] & ~2u, 0u);
    EXPECT_LE(int(result.num_seeing[at]), 1);
    EXPECT_TRUE(result.depth[at] == 0 || result.depth[at] >= 10.499f);
  }
}

TEST(PatchMatchSir, SmallWindowsAreNoSpecialCase) {
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 5}, {2, 2}, {3, 7}, {9, 2}, {16, 5}}) {
    std::vector<uint8_t> grey(size_t(width) * height, 90);
    ViewWindow window = scene.reference.Window();
    window.rectangle = {80, 60, width, height};
    window.grey = grey.data();
    EXPECT_EQ(scene.RunPass(0, nullptr, {}, window.rectangle).depth.size(), grey.size());
    if (width == 1) continue;
    // As a source it is smaller than a patch: nothing can be compared.
    const OneBlock one{1};
    const PatchMatchResult blind =
        PatchMatchSir(scene.reference.Window(), {window}, one.View(), {}, nullptr, {});
    EXPECT_EQ(std::count(blind.num_seeing.begin(), blind.num_seeing.end(), 0), kWidth * kHeight);
  }
}

TEST(PatchMatchSir, WhatNoSourceSeesHasNoDepth) {
  Scene scene(PlaneSurface({0, 0, -1}, -10));
  scene.sources = {Render({60, 0, 0}, PlaneSurface({0, 0, -1}, -10), kWidth, kHeight)};
  scene.blocks.allowed = 1;
  const PatchMatchResult result = scene.Run();
  EXPECT_EQ(std::count(result.depth.begin(), result.depth.end(), 0.f), kWidth * kHeight);
}

TEST(PatchMatchSir, ASourceThatIsNotGivenIsOneThatSeesNothing) {
  const Scene scene(PlaneSurface(kSlanted, kSlanted.z() * 10), kSlanted);
  const std::vector<float> inverse_depth(4, 0.1f);
  for (bool geometric : {false, true}) {
    std::vector<ViewWindow> windows;
    for (const RenderedView& source : scene.sources) windows.push_back(source.Window(geometric));
    const std::vector<uint32_t> views(kWidth * kHeight, 15);
    const StartMaps start{0,
                          {0, 0, kWidth, kHeight},
                          scene.reference.depth.data(),
                          scene.reference.normal.data(),
                          views.data()};
    // Two by two pixels in a corner, where no patch lies.
    windows[1].rectangle = {0, 0, 2, 2};
    if (geometric) windows[1].inverse_depth = inverse_depth.data();
    const auto run = [&] {
      return PatchMatchSir(scene.reference.Window(), windows, scene.blocks.View(), {}, &start, {});
    };
    const PatchMatchResult small = run();
    windows[1] = ViewWindow{};
    const PatchMatchResult none = run();
    EXPECT_EQ(small.depth, none.depth);
    EXPECT_EQ(small.normal, none.normal);
    EXPECT_EQ(small.views, none.views);
    EXPECT_EQ(small.cost, none.cost);
    EXPECT_EQ(small.num_consistent, none.num_consistent);
    EXPECT_EQ(*std::max_element(none.num_seeing.begin(), none.num_seeing.end()), 3);
  }
}

TEST(PatchMatchOptions, ErrorNamesFieldValueAndBound) {
  PatchMatchOptions options;
  options.iterations = -1;
  try {
    options.Validate();
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_STREQ(error.what(),
                 "PatchMatchOptions::iterations = -1.000000. Violated constraint: iterations >= 0");
  }
}

}  // namespace
}  // namespace sirpy
