#include "patch_match_sir.h"

#include <algorithm>
#include <cstdlib>

#include <gtest/gtest.h>

#include "plane_scene.h"

namespace sirpy {
namespace {

constexpr int kWidth = 160, kHeight = 120;

struct Scene {
  RenderedView reference;
  std::vector<RenderedView> sources;

  Scene(const Surface& surface, const Eigen::Vector3d& normal = {0, 0, -1}) {
    reference = Render({0, 0, 0}, surface, kWidth, kHeight, normal);
    for (const Eigen::Vector3d& centre :
         {Eigen::Vector3d(-1.5, 0, 0), {1.5, 0.2, 0}, {0.1, 1.4, 0}, {-0.2, -1.5, 0.1}}) {
      sources.push_back(Render(centre, surface, kWidth, kHeight, normal));
    }
  }

  PatchMatchResult Run(PatchMatchOptions options = {}, bool geometric = false) const {
    options.min_depth = 7;
    options.max_depth = 14;
    std::vector<ViewWindow> windows;
    for (const RenderedView& source : sources) windows.push_back(source.Window(geometric));
    return PatchMatchSir(reference.Window(geometric), windows, {{80, 60, 10}}, options);
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
    PatchMatchOptions options;
    options.levels = levels;
    EXPECT_LT(std::abs(Median(scene.ShiftErrors(scene.Run(options)))), 0.02) << levels << " levels";
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
  const PatchMatchResult result = scene.Run({}, true);
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
}

TEST(PatchMatchSir, SmallWindowsAreNoSpecialCase) {
  const Scene scene(PlaneSurface({0, 0, -1}, -10));
  PatchMatchOptions options;
  options.min_depth = 7;
  options.max_depth = 14;
  for (const auto& [width, height] : {std::pair{2, 2}, {3, 7}, {9, 2}, {16, 1 + 4}}) {
    std::vector<uint8_t> grey(size_t(width) * height, 90);
    ViewWindow window = scene.reference.Window();
    window.rectangle = {80, 60, width, height};
    window.grey = grey.data();
    std::vector<ViewWindow> sources;
    for (const RenderedView& source : scene.sources) sources.push_back(source.Window());
    EXPECT_EQ(PatchMatchSir(window, sources, {}, options).depth.size(), grey.size());
    // As a source it is smaller than a patch: nothing can be compared.
    const PatchMatchResult blind = PatchMatchSir(scene.reference.Window(), {window}, {}, options);
    EXPECT_EQ(std::count(blind.num_seeing.begin(), blind.num_seeing.end(), 0), kWidth * kHeight);
  }
}

TEST(PatchMatchSir, WhatNoSourceSeesHasNoDepth) {
  Scene scene(PlaneSurface({0, 0, -1}, -10));
  scene.sources = {Render({60, 0, 0}, PlaneSurface({0, 0, -1}, -10), kWidth, kHeight)};
  const PatchMatchResult result = scene.Run();
  EXPECT_EQ(std::count(result.depth.begin(), result.depth.end(), 0.f), kWidth * kHeight);
}

TEST(PatchMatchOptions, ErrorNamesFieldValueAndBound) {
  PatchMatchOptions options;
  options.min_depth = 1;
  options.max_depth = 0.5;
  try {
    options.Validate();
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_STREQ(
        error.what(),
        "PatchMatchOptions::max_depth = 0.500000. Violated constraint: max_depth > min_depth");
  }
}

}  // namespace
}  // namespace sirpy
