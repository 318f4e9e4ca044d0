// Least-squares matching (A. Gruen, "Adaptive least squares correlation", 1985): where in a target
// photograph the surroundings of a pixel of a reference photograph are, to some hundredths of a
// pixel, and how well that is known.
//
// Positions are in pixels of a patch: the centre of its top-left pixel is at (0, 0).
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace sirpy {

// A square of luma, row-major; from `white` on it counts as saturated.
struct LumaPatch {
  const uint16_t* luma = nullptr;
  int side = 0;
  int white = 1 << 16;

  float At(int x, int y) const { return luma[y * side + x]; }
};

struct MatchingOptions {
  int radius = 10;        // of the window that is compared, in pixels of the reference
  int search_radius = 9;  // of the error of the prediction, in pixels of the reference
  double min_correlation = 0.75;
  double max_rival = 0.6;      // share of a rival's distance from perfection that the best may have
  double max_deviation = 0.2;  // standard deviation of the position, pixels of the target
  double max_distortion = 0.5;  // of the affine map beside the predicted one
  double max_saturated = 0.1;   // share of the window, in either photograph
  double grey_level = 256;      // luma: what the coarser photograph rounds to
};

enum class MatchStatus : uint8_t {
  kMatched,
  kOutside,    // the window does not fit into a patch
  kSaturated,  // too many pixels at the upper end
  kUnlike,     // nothing that looks alike: hidden, moving, water
  kAmbiguous,  // two places that look alike: repeated patterns
  kDistorted,  // the shape or the place that fits best is far from what was predicted
  kWeak,       // the place is not well known: too little texture, few grey levels, or an edge
};

// target(position + affine * u) * gain + offset = reference(centre + u).
struct PatchMap {
  Eigen::Vector2d position = Eigen::Vector2d::Zero();
  Eigen::Matrix2d affine = Eigen::Matrix2d::Identity();
  double gain = 1;
  double offset = 0;
};

using PatchJacobian = Eigen::Matrix<double, 1, 8, Eigen::RowMajor>;

// The difference of one pixel, target less reference, and what it changes by with position (2),
// affine (4, row-major), gain and offset. `u` is relative to the centre. False where the bicubic
// interpolation (Keys, a = -1/2) needs pixels beyond the target.
bool PixelDifference(const LumaPatch& target, const PatchMap& map, const Eigen::Vector2d& u,
                     double reference, double* difference, PatchJacobian* jacobian);

struct PatchMatch {
  MatchStatus status = MatchStatus::kOutside;
  PatchMap map;
  // Of the position, pixels squared; of what is matched, positive definite.
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
  double correlation = 0;  // normalised, of the windows in the end
};

// The pixel within `radius` of `start` whose window (of options.radius) has the most texture in its
// weakest direction (Shi and Tomasi, "Good features to track", 1994); `start` where the patch is
// too small.
Eigen::Vector2i BestTextured(const LumaPatch& patch, const Eigen::Vector2i& start, int radius,
                             int window_radius);

// Where `centre` of the reference is in the target. `predicted` is searched around by normalised
// correlation, then improved by least squares.
PatchMatch MatchPatch(const LumaPatch& reference, const Eigen::Vector2i& centre,
                      const LumaPatch& target, const PatchMap& predicted,
                      const MatchingOptions& options);

}  // namespace sirpy
