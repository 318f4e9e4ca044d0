// Bundle adjustment of observations that each have a covariance, by Ceres.
//
// Geometry: a pose is a unit quaternion (x, y, z, w) and a centre (3): it takes a point X to
// R (X - centre). A frame's pose takes the world into its rig, a sensor's the rig into the sensor;
// a frame without a rig is a rig of one sensor. Sensors look along +z, x right, y down. Pixels are
// COLMAP's, the centre of the top-left pixel at (0.5, 0.5).
//
// What is least is half the sum of
//   rho(|W (observed - projected)|^2), W^T W the inverse of a covariance, rho Cauchy's,
//   |(centre - position) / sigma|^2 and
//   |(parameter - expected) / sigma|^2.
#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

namespace sirpy {

template <int kColumns>
using Rows = Eigen::Matrix<double, Eigen::Dynamic, kColumns, Eigen::RowMajor>;

struct AdjustedCamera {
  std::string lens;  // of LensNames()
  std::vector<double> parameters;
  std::vector<bool> free;  // of each parameter
  // What each is expected to be, and how far from it: 0 where nothing is expected.
  std::vector<double> expected;
  std::vector<double> expected_sigma;
};

struct AdjustedImage {
  int32_t camera = 0;
  int32_t frame = 0;
  int32_t sensor = -1;  // -1: the one that its rig's frame is that of
};

// What is adjusted. Memory while it is: about 1 kB per observation, and
// (6 frames)^2 * 8 bytes where the reduced equations are dense.
struct AdjustedModel {
  std::vector<AdjustedCamera> cameras;
  Rows<7> frames;   // rig from world
  Rows<7> sensors;  // sensor from rig
  std::vector<AdjustedImage> images;
  Rows<3> points;  // world
};

// Of each image and point: rows of the same index belong together.
struct Observations {
  std::vector<int32_t> image;
  std::vector<int32_t> point;  // ascending
  Rows<2> xy;                  // pixels
  Rows<4> whitening;           // W, row-major, 1 / pixels
};

// Where the centres of images are known to lie.
struct Positions {
  std::vector<int32_t> image;
  Rows<3> centre;  // world
  Rows<3> sigma;   // of each coordinate
};

struct AdjustmentOptions {
  double loss_scale = 3;  // of Cauchy's loss, in whitened units
  int iterations = 100;   // at most
  bool deviations = false;

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

struct Adjustment {
  bool usable = false;
  std::string message;  // of Ceres
  AdjustedModel model;
  // Of each camera, the standard deviations of its parameters if those of the whitened observations
  // are 1 and nothing is expected of them, 0 where not free. None where the observations do not
  // determine them, where they were not asked for, and where there are more unknowns than
  // kMostUnknowns.
  std::vector<std::vector<double>> deviations;

  static constexpr int kMostUnknowns = 3000;  // without points: 72 MB, some seconds
};

// Names of COLMAP's camera models that can be adjusted.
std::vector<std::string> LensNames();

// Runs on one thread: the sums of several differ in their last bits from run to run.
// Without positions, the first frame and one coordinate of another stay where they are.
// Throws std::invalid_argument where indices or sizes do not fit together.
Adjustment Adjust(AdjustedModel model, const Observations& observations, const Positions& positions,
                  const AdjustmentOptions& options);

// Observed minus projected, pixels.
Rows<2> Residuals(const AdjustedModel& model, const Observations& observations);

}  // namespace sirpy
