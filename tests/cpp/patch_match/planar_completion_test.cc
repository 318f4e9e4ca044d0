#include "patch_match/planar_completion.h"

#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "patch_match/random.h"

namespace sirpy {
namespace {

constexpr int kWidth = 120, kHeight = 100;
constexpr uint8_t kGround = 100, kRoof = 160;
constexpr float kNoDepth = 55;  // of pixels that nothing was found for

bool OnRoof(int x, int y) { return x >= 40 && x < 90 && y >= 30 && y < 70; }
bool NearBorder(int x, int y) { return x < 46 || x >= 84 || y < 36 || y >= 64; }
bool OnGround(int x, int y) { return !OnRoof(x, y); }

// Inverse depths of the two planes at a pixel of the window; the roof is tilted.
double GroundRho(int, int) { return 1 / 100.0; }
double RoofRho(int x, int y) { return 1 / 90.0 + 2e-6 * (x - 60) - 1e-6 * (y - 50); }

double Noise(int x, int y, int what) {
  return patch_match::Uniform(patch_match::Hash(7, uint64_t(y) << 32 | uint32_t(x), what));
}

// A flat roof above flat ground, both without texture; nothing is known yet.
struct Scene {
  std::vector<uint8_t> grey = std::vector<uint8_t>(kWidth * kHeight);
  std::vector<float> depth = std::vector<float>(kWidth * kHeight, kNoDepth);
  std::vector<float> normal = std::vector<float>(3 * kWidth * kHeight);
  std::vector<uint32_t> views = std::vector<uint32_t>(kWidth * kHeight, 1);
  std::vector<float> texture = std::vector<float>(kWidth * kHeight, 1);
  std::vector<uint8_t> num_consistent = std::vector<uint8_t>(kWidth * kHeight);

  Scene() {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) grey[y * kWidth + x] = OnRoof(x, y) ? kRoof : kGround;
    }
  }

  void Know(int x, int y, double rho, float contrast = 1) {
    const int at = y * kWidth + x;
    depth[at] = float(1 / rho);
    num_consistent[at] = 3;
    texture[at] = contrast;
  }

  // The depths of a plane, within `amplitude` pixels of motion, become known where `where` says so.
  void Know(const std::function<bool(int, int)>& where, double (*rho)(int, int),
            double amplitude = 0, float contrast = 1) {
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double error = amplitude * (2 * Noise(x, y, 0) - 1) / kMotion;
        if (where(x, y)) Know(x, y, rho(x, y) + error, contrast);
      }
    }
  }

  // One source, 50 to the right: its image moves by about f 50 pixels per unit of inverse depth.
  static constexpr double kFocal = 400, kBaseline = 50, kMotion = kFocal * kBaseline;

  PlanarCompletion Complete(PlanarCompletionOptions options = {}) const {
    CompletionMaps maps;
    maps.level = 2;
    maps.window = {8, 4, kWidth, kHeight};
    maps.intrinsics << 4 * kFocal, 0, 4 * 68, 0, 4 * kFocal, 4 * 54, 0, 0, 1;
    maps.grey = grey.data();
    maps.depth = depth.data();
    maps.normal = normal.data();
    maps.views = views.data();
    maps.texture = texture.data();
    maps.num_consistent = num_consistent.data();
    return CompletePlanes(maps, {{kBaseline, 0, 0}}, options);
  }
};

// The worst error of the completed roof, in pixels of motion, and how many of its pixels are.
struct Quality {
  double worst = 0;
  int count = 0;
};
Quality OfRoof(const PlanarCompletion& result) {
  Quality quality;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int at = y * kWidth + x;
      if (!OnRoof(x, y) || !result.completed[at]) continue;
      const double error = std::abs(1 / result.depth[at] - RoofRho(x, y)) * Scene::kMotion;
      quality.worst = std::max(quality.worst, error);
      ++quality.count;
    }
  }
  return quality;
}

constexpr int kRoofPixels = 50 * 40;

TEST(CompletePlanes, TheRimGivesTheRoofItsPlane) {
  Scene scene;
  scene.Know(OnGround, GroundRho);
  scene.Know([](int x, int y) { return OnRoof(x, y) && NearBorder(x, y); }, RoofRho);
  const PlanarCompletion result = scene.Complete();
  const Quality quality = OfRoof(result);
  // The corners of the smoothed picture are neither ground nor roof.
  EXPECT_GT(quality.count, 0.9 * kRoofPixels);
  EXPECT_LT(quality.worst, 1e-3);
  // The normal is that of the plane: along K^T (gx, gy, rho at the principal point), to the camera.
  const int at = 50 * kWidth + 60;
  const Eigen::Vector3d inward(400 * 2e-6, 400 * -1e-6, RoofRho(60, 50) + 0.5 * (-2e-6 + 1e-6));
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(result.normal[at + i * kWidth * kHeight], -inward.normalized()(i), 1e-4);
  }
}

TEST(CompletePlanes, TheGroundDoesNotCreepOntoARoofThatNothingIsKnownOf) {
  Scene scene;
  scene.Know(OnGround, GroundRho);
  const PlanarCompletion result = scene.Complete();
  EXPECT_EQ(OfRoof(result).count, 0);
  for (int y = 30; y < 70; ++y) {
    for (int x = 40; x < 90; ++x) EXPECT_EQ(result.depth[y * kWidth + x], kNoDepth);
  }
}

TEST(CompletePlanes, WrongDepthsAreOutvoted) {
  Scene scene;
  scene.Know([](int x, int y) { return OnRoof(x, y) && Noise(x, y, 1) < 0.5; }, RoofRho, 0.3);
  scene.Know([](int x, int y) { return OnRoof(x, y) && Noise(x, y, 1) < 0.12; }, GroundRho, 20);
  const Quality quality = OfRoof(scene.Complete());
  EXPECT_GT(quality.count, 0.9 * kRoofPixels);
  EXPECT_LT(quality.worst, 0.25);
}

TEST(CompletePlanes, APatchThatHoldsTheParapetSaysNothingOfTheRoof) {
  Scene scene;
  const auto parapet = [](int x, int y) { return 1.01 * RoofRho(x, y); };  // 2 pixels of motion
  scene.Know([](int x, int y) { return OnRoof(x, y) && NearBorder(x, y); }, parapet, 0, 40);
  scene.Know([](int x, int y) { return OnRoof(x, y) && !NearBorder(x, y) && (x + y) % 3 == 0; },
             RoofRho);
  const Quality quality = OfRoof(scene.Complete());
  EXPECT_GT(quality.count, 0.9 * kRoofPixels);
  EXPECT_LT(quality.worst, 0.01);
}

TEST(CompletePlanes, NothingIsInventedWhereDepthsAgreeOnNoPlane) {
  Scene scene;  // water: its depths are random, though some agree by chance
  scene.Know(OnRoof, RoofRho, 20);
  EXPECT_EQ(OfRoof(scene.Complete()).count, 0);
}

TEST(CompletePlanes, ALineDoesNotMakeAPlane) {
  Scene scene;
  scene.Know([](int x, int y) { return OnRoof(x, y) && y == 50; }, RoofRho);
  EXPECT_EQ(OfRoof(scene.Complete()).count, 0);
}

TEST(CompletePlanes, TextureThatSourcesConfirmKeepsItsDepth) {
  Scene scene;
  scene.Know(OnRoof, RoofRho);
  scene.Know(60, 50, GroundRho(60, 50), 100);
  scene.Know(70, 50, GroundRho(70, 50), 100);
  scene.num_consistent[50 * kWidth + 70] = 1;
  const PlanarCompletion result = scene.Complete();
  EXPECT_FLOAT_EQ(result.depth[50 * kWidth + 60], 100);
  EXPECT_NEAR(result.depth[50 * kWidth + 70], 1 / RoofRho(70, 50), 1e-3);
}

TEST(CompletePlanes, ARoundReachesWhatOnlyPlanesOfTheOneBeforeSupport) {
  Scene scene;
  for (auto& grey : scene.grey) grey = kRoof;
  // Known in the corner only: too far from the opposite one for a ray.
  scene.Know([](int x, int y) { return x < 40 && y < 40; }, RoofRho);
  const auto count = [&](int rounds) {
    PlanarCompletionOptions options;
    options.rounds = rounds;
    int completed = 0;
    for (const uint8_t one : scene.Complete(options).completed) completed += one;
    return completed;
  };
  const int once = count(1), twice = count(2), often = count(4);
  EXPECT_LT(once, twice);
  EXPECT_LT(twice, often);
  EXPECT_EQ(often, kWidth * kHeight);
}

TEST(CompletePlanes, ThreadsDoNotMatter) {
  Scene scene;
  scene.Know([](int x, int y) { return Noise(x, y, 1) < 0.3; }, RoofRho, 0.6);
  PlanarCompletionOptions options;
  options.threads = 1;
  const PlanarCompletion one = scene.Complete(options);
  options.threads = 3;
  const PlanarCompletion three = scene.Complete(options);
  EXPECT_EQ(one.depth, three.depth);
  EXPECT_EQ(one.normal, three.normal);
  EXPECT_EQ(one.completed, three.completed);
}

TEST(PlanarCompletionOptions, NamesWhatIsWrong) {
  PlanarCompletionOptions options;
  options.min_share = 0;
  try {
    Scene().Complete(options);
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("min_share"), std::string::npos);
  }
}

}  // namespace
}  // namespace sirpy
