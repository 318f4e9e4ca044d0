#include "bundle_adjustment.h"

#include <ceres/ceres.h>
#include <ceres/gradient_checker.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <set>

#include "reprojection.h"

namespace sirpy {
namespace {

using Pose = std::array<double, 7>;

const Pose kFrame{0.1, -0.2, 0.05, std::sqrt(1 - 0.0525), 0.3, -0.1, -5};
const Pose kSensor{-0.02, 0.1, 0.04, std::sqrt(1 - 0.012), 0.2, 0.1, 0.05};
const Eigen::Matrix<double, 2, 2, Eigen::RowMajor> kWhitening{{2.0, 0.0}, {-0.7, 1.3}};

std::vector<double> Parameters(int count) {
  std::vector<double> parameters(count);
  for (int i = 0; i < count; ++i) parameters[i] = 0.02 / (1 + i) * (i % 2 ? -1 : 1);
  parameters[0] = 900;
  return parameters;
}

TEST(BundleAdjustmentTest, DerivativesOfEveryLensAreThoseOfFiniteDifferences) {
  const ceres::EigenQuaternionManifold quaternion;
  const ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>> pose;
  const double point[3] = {0.4, -0.3, 0.2};
  std::set<std::string> checked;
  ForEachLens([&](const char* name, auto lens) {
    using Lens = decltype(lens);
    std::vector<double> parameters = Parameters(Lens::kParameters);
    if (std::string(name).find("SIMPLE") == std::string::npos) parameters[1] = 910;
    using Residual = Reprojection<Lens>;
    const ceres::AutoDiffCostFunction<Residual, 2, 7, 7, Lens::kParameters, 3> cost(
        new Residual{Eigen::Vector2d(12, 34), kWhitening});
    const std::vector<const ceres::Manifold*> manifolds{&pose, &pose, nullptr, nullptr};
    ceres::NumericDiffOptions options;
    options.relative_step_size = 1e-5;
    ceres::GradientChecker checker(&cost, &manifolds, options);
    const double* const blocks[] = {kFrame.data(), kSensor.data(), parameters.data(), point};
    ceres::GradientChecker::ProbeResults results;
    EXPECT_TRUE(checker.Probe(blocks, 1e-6, &results)) << name << results.error_log;
    checked.insert(name);
  });
  EXPECT_EQ(checked.size(), LensNames().size());
}

// Eight frames around points; the observations are exact.
struct Scene {
  AdjustedModel model;
  Observations observations;
};

Scene MakeScene() {
  std::mt19937 random(1);
  const auto uniform = [&random](double size) {
    return size * (static_cast<double>(random()) / std::mt19937::max() - 0.5);
  };
  Scene scene;
  AdjustedModel& model = scene.model;
  model.cameras.push_back({"SIMPLE_RADIAL",
                           {900, 500, 400, -0.05},
                           {true, false, false, true},
                           {0, 0, 0, 0},
                           {0, 0, 0, 0}});
  const int frames = 8, points = 60;
  model.frames.resize(frames, 7);
  model.sensors.resize(0, 7);
  for (int i = 0; i < frames; ++i) {
    const Eigen::Quaterniond turn = Eigen::AngleAxisd(uniform(0.4), Eigen::Vector3d::UnitX()) *
                                    Eigen::AngleAxisd(uniform(0.4), Eigen::Vector3d::UnitY()) *
                                    Eigen::AngleAxisd(i, Eigen::Vector3d::UnitZ());
    model.frames.row(i) << turn.coeffs().transpose(), uniform(4), uniform(4), -8 + uniform(2);
    model.images.push_back({0, i, -1});
  }
  model.points.resize(points, 3);
  for (int i = 0; i < points; ++i) model.points.row(i) << uniform(4), uniform(4), uniform(1);
  Observations& observations = scene.observations;
  observations.xy = Rows<2>::Zero(frames * points, 2);
  observations.whitening = Rows<4>::Zero(frames * points, 4);
  for (int point = 0; point < points; ++point) {
    for (int image = 0; image < frames; ++image) {
      observations.whitening.row(observations.image.size()) << 10, 0, 0, 10;
      observations.image.push_back(image);
      observations.point.push_back(point);
    }
  }
  observations.xy = -Residuals(model, observations);
  return scene;
}

TEST(BundleAdjustmentTest, ExactObservationsGiveTheExactLensAndHoldTheFirstFrame) {
  const Scene scene = MakeScene();
  AdjustedModel start = scene.model;
  start.cameras[0].parameters[0] = 920;
  start.points.array() += 0.01;
  const Adjustment done = Adjust(start, scene.observations, {}, {});
  ASSERT_TRUE(done.usable) << done.message;
  EXPECT_NEAR(done.model.cameras[0].parameters[0], 900, 1e-5);
  EXPECT_NEAR(done.model.cameras[0].parameters[3], -0.05, 1e-8);
  EXPECT_EQ(done.model.cameras[0].parameters[1], 500);
  EXPECT_EQ(done.model.frames.row(0), start.frames.row(0));
  EXPECT_LT(Residuals(done.model, scene.observations).cwiseAbs().maxCoeff(), 1e-5);
}

// Observations of 0.1 px: the focal lengths of many noisy networks spread as the deviation says.
TEST(BundleAdjustmentTest, DeviationsAreTheSpreadOfTheLensesOfNoisyObservations) {
  const Scene scene = MakeScene();
  AdjustmentOptions options;
  options.loss_scale = 1e6;
  options.deviations = true;
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, 0.1);
  const int runs = 60;
  double squares = 0, deviation = 0;
  for (int run = 0; run < runs; ++run) {
    Observations noisy = scene.observations;
    noisy.xy = noisy.xy.unaryExpr([&](double x) { return x + noise(random); });
    const Adjustment done = Adjust(scene.model, noisy, {}, options);
    ASSERT_EQ(done.deviations[0].size(), 4u);
    EXPECT_EQ(done.deviations[0][1], 0);
    squares += std::pow(done.model.cameras[0].parameters[0] - 900, 2);
    deviation += done.deviations[0][0] / runs;
  }
  EXPECT_NEAR(std::sqrt(squares / runs), deviation, 0.3 * deviation);
}

TEST(BundleAdjustmentTest, WhatIsNotDeterminedHasNoDeviation) {
  Scene scene = MakeScene();
  // One frame sees everything, the other half its own place again: no baseline, no focal length.
  for (int i = 1; i < scene.model.frames.rows(); ++i) {
    scene.model.frames.row(i) = scene.model.frames.row(0);
  }
  scene.observations.xy += Residuals(scene.model, scene.observations) * -1;
  AdjustmentOptions options;
  options.deviations = true;
  const Adjustment done = Adjust(scene.model, scene.observations, {}, options);
  EXPECT_TRUE(done.deviations.empty() || done.deviations[0].empty());
}

TEST(BundleAdjustmentTest, RefusesWhatDoesNotFitTogether) {
  Scene scene = MakeScene();
  AdjustmentOptions options;
  options.loss_scale = 0;
  EXPECT_THROW(Adjust(scene.model, scene.observations, {}, options), std::invalid_argument);
  std::swap(scene.observations.point.front(), scene.observations.point.back());
  EXPECT_THROW(Adjust(scene.model, scene.observations, {}, {}), std::invalid_argument);
  scene = MakeScene();
  scene.observations.image[3] = 8;
  EXPECT_THROW(Adjust(scene.model, scene.observations, {}, {}), std::invalid_argument);
  scene = MakeScene();
  scene.model.cameras[0].lens = "FOV";
  EXPECT_THROW(Adjust(scene.model, scene.observations, {}, {}), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
