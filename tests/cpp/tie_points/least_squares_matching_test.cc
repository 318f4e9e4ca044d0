#include "tie_points/least_squares_matching.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <random>
#include <vector>

#include <gtest/gtest.h>
#include <Eigen/Dense>

namespace sirpy {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector2i;

constexpr int kSide = 91;
constexpr int kMiddle = kSide / 2;
constexpr int kWhite = 64000;

// Smooth noise: waves of many directions and of lengths from 5 pixels on, 20000 +- some thousands.
class Texture {
 public:
  explicit Texture(int seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> angle(0, 2 * M_PI), length(5, 25);
    for (int i = 0; i < 60; ++i) {
      const double direction = angle(random);
      const double frequency = 2 * M_PI / length(random);
      waves_.push_back(
          {frequency * std::cos(direction), frequency * std::sin(direction), angle(random)});
    }
  }
  double operator()(const Vector2d& at) const {
    double sum = 0;
    for (const auto& wave : waves_)
      sum += std::sin(wave.x() * at.x() + wave.y() * at.y() + wave.z());
    return 20000 + 900 * sum;
  }

 private:
  std::vector<Eigen::Vector3d> waves_;
};

using Surface = std::function<double(const Vector2d&)>;

struct Pixels {
  std::vector<uint16_t> luma;
  LumaPatch patch() const { return {luma.data(), kSide, kWhite}; }
};

// What a camera sees of a surface: noise in luma (256 are a grey level), positions about the
// middle.
Pixels Photograph(const Surface& surface, double noise, int seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> error(0, noise);
  Pixels pixels;
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const double value = surface(Vector2d(x - kMiddle, y - kMiddle)) + error(random);
      pixels.luma.push_back(static_cast<uint16_t>(std::clamp(value, 0.0, 65280.0)));
    }
  }
  return pixels;
}

PatchMap Predicted(const Vector2d& shift = Vector2d::Zero()) {
  PatchMap map;
  map.position = Vector2d(kMiddle, kMiddle) + shift;
  return map;
}

PatchMatch Match(const Pixels& reference, const Pixels& target, const PatchMap& predicted) {
  return MatchPatch(reference.patch(), {kMiddle, kMiddle}, target.patch(), predicted, {});
}

TEST(PixelDifference, JacobianIsThatOfFiniteDifferences) {
  const Pixels target = Photograph(Texture(1), 0, 1);
  PatchMap map = Predicted({0.3, -0.7});
  map.affine << 1.1, 0.2, -0.1, 0.9;
  map.gain = 1.2;
  map.offset = -300;
  const Vector2d u(4, -7);
  double difference;
  PatchJacobian jacobian;
  ASSERT_TRUE(PixelDifference(target.patch(), map, u, 12345, &difference, &jacobian));
  for (int i = 0; i < 8; ++i) {
    const double step = 1e-5;
    double values[2];
    for (int sign = 0; sign < 2; ++sign) {
      PatchMap moved = map;
      double* parameters[] = {&moved.position.x(), &moved.position.y(), &moved.affine(0, 0),
                              &moved.affine(0, 1), &moved.affine(1, 0), &moved.affine(1, 1),
                              &moved.gain,         &moved.offset};
      *parameters[i] += sign == 0 ? -step : step;
      PatchJacobian ignored;
      ASSERT_TRUE(PixelDifference(target.patch(), moved, u, 12345, &values[sign], &ignored));
    }
    const double quotient = (values[1] - values[0]) / (2 * step);
    EXPECT_NEAR(jacobian[i], quotient, 1e-5 * std::max(1.0, std::abs(quotient)))
        << "parameter " << i;
  }
}

TEST(MatchPatch, FindsAnAffineViewOfAnotherExposureToHundredthsOfAPixel) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> shift(-4, 4), distortion(-0.12, 0.12);
  double squares = 0;
  double expected = 0;
  const int count = 60;
  for (int i = 0; i < count; ++i) {
    const Texture texture(i);
    const Vector2d at(shift(random), shift(random));
    Matrix2d affine = Matrix2d::Identity();
    for (double& value : affine.reshaped()) value += distortion(random);
    const Matrix2d inverse = affine.inverse();
    const Pixels reference = Photograph(texture, 384, 2 * i);
    const Pixels target =
        Photograph([&](const Vector2d& p) { return 0.7 * texture(inverse * (p - at)) + 4000; }, 384,
                   2 * i + 1);
    const PatchMatch match = Match(reference, target, Predicted());
    ASSERT_EQ(match.status, MatchStatus::kMatched) << i;
    const Vector2d error = match.map.position - Vector2d(kMiddle, kMiddle) - at;
    EXPECT_LT(error.norm(), 0.1) << i;
    EXPECT_LT((match.map.affine - affine).norm(), 0.05) << i;
    EXPECT_NEAR(match.map.gain * 0.7, 1, 0.05) << i;
    squares += error.squaredNorm();
    expected += match.covariance.trace();
  }
  EXPECT_LT(std::sqrt(squares / count), 0.04);
  // The covariance tells the errors: within a factor of two in sigma.
  EXPECT_LT(squares / expected, 4);
  EXPECT_GT(squares / expected, 0.25);
}

TEST(MatchPatch, WhatIsNotThereIsUnlike) {  // water, a car that has gone, a hidden place
  int unlike = 0;
  for (int i = 0; i < 50; ++i) {
    const PatchMatch match = Match(Photograph(Texture(i), 384, i),
                                   Photograph(Texture(1000 + i), 384, 1000 + i), Predicted());
    EXPECT_NE(match.status, MatchStatus::kMatched) << i;
    unlike += match.status == MatchStatus::kUnlike;
  }
  EXPECT_GT(unlike, 40);
}

TEST(MatchPatch, RepeatedPatternsAreAmbiguous) {  // the tiles of a roof, 7 pixels apart
  const Surface roof = [](const Vector2d& p) {
    return 20000 + 6000 * std::sin(2 * M_PI * p.x() / 7) + 6000 * std::sin(2 * M_PI * p.y() / 7);
  };
  const PatchMatch match = Match(Photograph(roof, 384, 1), Photograph(roof, 384, 2), Predicted());
  EXPECT_EQ(match.status, MatchStatus::kAmbiguous);
}

TEST(MatchPatch, SaturatedPlacesAreLeftAlone) {
  const Texture texture(3);
  const Surface glare = [&](const Vector2d& p) { return p.x() > 4 ? 65280 : texture(p); };
  const PatchMatch match = Match(Photograph(glare, 384, 1), Photograph(glare, 384, 2), Predicted());
  EXPECT_EQ(match.status, MatchStatus::kSaturated);
  // In the longer exposure alone.
  const Surface longer = [&](const Vector2d& p) { return 2.9 * texture(p); };
  const PatchMatch over =
      Match(Photograph(texture, 384, 1), Photograph(longer, 384, 2), Predicted());
  EXPECT_EQ(over.status, MatchStatus::kSaturated);
}

TEST(MatchPatch, AnEdgeOrNoTextureIsWeak) {
  const Surface edge = [](const Vector2d& p) { return 20000 + 8000 * std::tanh(p.x() / 2); };
  const Surface flat = [](const Vector2d&) { return 20000; };
  for (const Surface& surface : {edge, flat}) {
    const PatchMatch match =
        Match(Photograph(surface, 384, 1), Photograph(surface, 384, 2), Predicted());
    EXPECT_NE(match.status, MatchStatus::kMatched);
  }
  EXPECT_EQ(Match(Photograph(flat, 0, 1), Photograph(flat, 0, 2), Predicted()).status,
            MatchStatus::kWeak);
}

// A photograph of an extreme compression: 8x8 blocks of one value each, of few grey levels.
Surface Blocks(const Surface& surface, double level) {
  return [=](const Vector2d& p) {
    const Vector2d middle = ((p.array() / 8).floor() + 0.5) * 8;
    return std::round(surface(middle) / level) * level;
  };
}

// What least squares may weigh by: the same in both triangles, and none of the directions exact.
void ExpectSound(const Matrix2d& covariance) {
  EXPECT_EQ(covariance(0, 1), covariance(1, 0));
  const double least = covariance.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff();
  EXPECT_GT(least, 1e-8);
}

TEST(MatchPatch, PosterisedSurroundingsAreWeakOrHaveASoundCovariance) {
  int weak = 0, matched = 0;
  for (int i = 0; i < 200; ++i) {
    const Texture texture(i);
    const Surface smooth = [&](const Vector2d& p) { return texture(p / 6); };
    const Surface blocks = Blocks(smooth, 256 * (20 + i % 20));
    const Pixels reference = Photograph(blocks, 0, 1);
    // The grid of the blocks stays where it is; the other exposure is of other grey levels.
    const double gain = i % 3 == 0 ? 0.8 : 1;
    const Pixels target = Photograph([&](const Vector2d& p) { return gain * blocks(p); }, 0, 1);
    const PatchMatch match = Match(reference, target, Predicted());
    weak += match.status == MatchStatus::kWeak;
    if (match.status != MatchStatus::kMatched) continue;
    ++matched;
    ExpectSound(match.covariance);
  }
  EXPECT_GT(weak, 20);
  EXPECT_GT(matched, 20);
}

TEST(MatchPatch, AnExactEdgeIsNoTiePoint) {  // no noise tells which direction is not known
  MatchingOptions options;
  options.max_rival = 1e9;  // all along the edge is alike: least squares must tell themselves
  for (const double angle : {0.0, 0.3, 1.1, 0.5 * M_PI}) {
    const Vector2d across(std::cos(angle), std::sin(angle));
    const Surface edge = [&](const Vector2d& p) {
      return 20000 + 8000 * std::tanh(across.dot(p) / 2);
    };
    const Pixels pixels = Photograph(edge, 0, 1);
    EXPECT_EQ(Match(pixels, pixels, Predicted()).status, MatchStatus::kAmbiguous) << angle;
    const PatchMatch match =
        MatchPatch(pixels.patch(), {kMiddle, kMiddle}, pixels.patch(), Predicted(), options);
    // One end of the edge is at the border of what is searched.
    EXPECT_TRUE(match.status == MatchStatus::kWeak || match.status == MatchStatus::kDistorted)
        << angle;
  }
}

TEST(MatchPatch, ConstantSurroundingsAreWeakAndBrightOnesSaturated) {
  for (const double value : {0.0, 256.0, 30000.0}) {
    const Pixels flat = Photograph([&](const Vector2d&) { return value; }, 0, 1);
    EXPECT_EQ(Match(flat, flat, Predicted()).status, MatchStatus::kWeak) << value;
    // In one photograph alone.
    const Pixels textured = Photograph(Texture(2), 0, 1);
    EXPECT_EQ(Match(flat, textured, Predicted()).status, MatchStatus::kWeak) << value;
    EXPECT_EQ(Match(textured, flat, Predicted()).status, MatchStatus::kUnlike) << value;
  }
  const Pixels white = Photograph([](const Vector2d&) { return 65280; }, 0, 1);
  EXPECT_EQ(Match(white, white, Predicted()).status, MatchStatus::kSaturated);
}

TEST(MatchPatch, APerfectMatchIsAsGoodAsItsGreyLevelsAndNoBetter) {
  for (int i = 0; i < 20; ++i) {
    const Pixels pixels = Photograph(Texture(i), 0, 1);
    const PatchMatch match = Match(pixels, pixels, Predicted());
    ASSERT_EQ(match.status, MatchStatus::kMatched) << i;
    ExpectSound(match.covariance);
    MatchingOptions coarser;
    coarser.grey_level = 512;
    const PatchMatch half =
        MatchPatch(pixels.patch(), {kMiddle, kMiddle}, pixels.patch(), Predicted(), coarser);
    EXPECT_NEAR(half.covariance.trace() / match.covariance.trace(), 4, 1e-6);
  }
}

TEST(MatchPatch, WhatRepeatsExactlyIsAmbiguous) {  // without noise both fit perfectly
  for (int i = 0; i < 20; ++i) {
    const Texture texture(i);
    const Surface tiles = [&](const Vector2d& p) {
      const auto of_tile = [](double x) { return x - 7 * std::floor(x / 7); };
      return texture({of_tile(p.x()), p.y()});
    };
    const Pixels pixels = Photograph(tiles, 0, 1);
    EXPECT_EQ(Match(pixels, pixels, Predicted()).status, MatchStatus::kAmbiguous) << i;
  }
}

TEST(MatchPatch, WhatLiesBeyondTheSearchIsNeverMatched) {
  const Texture texture(5);
  for (const double far : {9.4, 12.0, 20.0}) {
    const Surface moved = [&](const Vector2d& p) { return texture(p - Vector2d(far, 0)); };
    const PatchMatch match =
        Match(Photograph(texture, 384, 1), Photograph(moved, 384, 2), Predicted());
    EXPECT_NE(match.status, MatchStatus::kMatched) << far;
  }
}

TEST(MatchPatch, WindowsBeyondThePatchAreOutside) {
  const Pixels pixels = Photograph(Texture(1), 0, 1);
  for (const Vector2d& shift :
       {Vector2d(40, 0), Vector2d(0, -40), Vector2d(1e9, 0), Vector2d(std::nan(""), 0)}) {
    EXPECT_EQ(Match(pixels, pixels, Predicted(shift)).status, MatchStatus::kOutside);
  }
  const PatchMatch match =
      MatchPatch(pixels.patch(), {3, kMiddle}, pixels.patch(), Predicted(), {});
  EXPECT_EQ(match.status, MatchStatus::kOutside);
}

TEST(BestTextured, FindsTheCornerNotTheEdge) {
  // A dark square whose corner is at (3, -2), in a bright surface without texture.
  const Surface corner = [](const Vector2d& p) {
    return p.x() > 3 && p.y() > -2 ? 10000.0 : 30000.0;
  };
  const Pixels pixels = Photograph(corner, 0, 1);
  const Vector2i best = BestTextured(pixels.patch(), {kMiddle, kMiddle}, 6, 4);
  EXPECT_NEAR(best.x() - kMiddle, 3, 4);
  EXPECT_NEAR(best.y() - kMiddle, -2, 4);
  EXPECT_EQ(BestTextured(pixels.patch(), {3, 3}, 6, 4), Vector2i(3, 3));
}

}  // namespace
}  // namespace sirpy
