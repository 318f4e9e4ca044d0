// Renders a scene as a camera sees it. The camera is given by its rays at the corners of the
// pixels, so every lens is exact and this code knows no camera model: node (row, column) of a (rows
// + 1) x (columns + 1) grid holds the ray (x, y, 1), in the camera frame, of the image point
// (column, row), with the centre of the top-left pixel at (0.5, 0.5). Rays inside a pixel are
// interpolated between its corners (error below 1/10,000 pixel for a photographic lens).
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "synthetic/scene.h"

namespace sirpy {

struct RenderOptions {
  int samples = 2;                         // samples x samples rays a pixel
  Eigen::Vector3d sun{-0.45, -0.35, 0.8};  // direction to the sun, world frame
  double noise = 0.8;                      // standard deviation of the sensor's noise, grey levels
  uint64_t seed = 1;                       // of the noise: give every photograph its own
  int threads = 0;                         // 0: as many as there are; never changes the result

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// A band of rows of a camera's image.
struct RayBand {
  const double* nodes;  // (rows + 1) x (columns + 1) x 2, row-major
  int64_t rows;
  int64_t columns;
  int64_t first_row;               // of the band in the image
  Eigen::Vector3d centre;          // of projection, world frame
  Eigen::Matrix3d world_from_cam;  // rotation
};

// RGB, 8 bit, rows x columns x 3. What lies beyond the scene is a bright sky.
std::vector<uint8_t> Render(const Scene& scene, const RayBand& band, const RenderOptions& options);

}  // namespace sirpy
