// Planes for weak texture: depths that nothing can be matched for are taken from the plane that
// surfaces of the same grey around them support.
//
// Geometry: a window of one level of a native image, row-major; depth is z in the camera (0 where
// there is none), normals are 3 planes in the camera frame; cameras and levels as in
// patch_match_sir.h. On a plane the inverse depth is affine in the pixel.
//
// Planar priors for weak texture: Xu and Tao, ACMP, AAAI 2020 (triangles between reliable pixels);
// Romanoni and Matteucci, TAPA-MVS, ICCV 2019 (planes of superpixels); Wang et al., APD-MVS, CVPR
// 2023 (planes through reliable pixels found in sectors around each pixel). Ours: the reliable
// pixels are seen from the pixel along rays that end where the grey level changes, so a plane does
// not pass an edge and textured surfaces, where rays end at once, are left alone; and a plane is
// taken only where the fit says that it is known well enough at this pixel.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

struct PlanarCompletionOptions {
  double grey_step = 6;      // grey levels (smoothed): farther ones are another surface
  double edge_texture = 64;  // grey levels squared: above, a depth that sources confirm is kept
  // Grey levels squared: patches with more contrast do not support a plane. Where the surface has
  // none, they hold its border, and that may be at the depth of another (a parapet, say).
  double weak_texture = 16;
  int min_consistent = 2;  // sources that agree with the depth of a reliable pixel
  double tolerance = 0.6;  // pixels of motion in the sources: on the plane
  double min_share = 0.6;  // of the reliable pixels must lie on the plane
  int min_samples = 12;    // of them
  // Pixels of motion: standard error of the plane at the pixel, by the scatter of the samples on
  // it. The error of planes that come in as samples of a later round is not in it.
  double max_error = 0.25;
  int rounds = 2;   // the planes of one support those of the next
  int threads = 0;  // 0: one for each core

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// What a geometric pass has found; the arrays are not owned.
struct CompletionMaps {
  int level = 0;
  Rectangle window;            // pixels of the level
  Eigen::Matrix3d intrinsics;  // K of the whole native image
  const uint8_t* grey = nullptr;
  const float* depth = nullptr;
  const float* normal = nullptr;
  const uint32_t* views = nullptr;          // bit j: source j was used
  const float* texture = nullptr;           // variance of the patch, grey levels squared
  const uint8_t* num_consistent = nullptr;  // sources that agree
};

struct PlanarCompletion {
  std::vector<float> depth;
  std::vector<float> normal;       // 3 planes
  std::vector<uint8_t> completed;  // 1 where depth and normal are those of a plane around
};

// How far from a pixel, in pixels of the level, its plane can depend on the maps: two rounds of
// rays, and the smoothed grey levels at their ends.
constexpr int kPlanarCompletionMargin = 2 * (48 + 1);

// `source_centres`: projection centres of the sources in the camera frame of the reference.
PlanarCompletion CompletePlanes(const CompletionMaps& maps,
                                const std::vector<Eigen::Vector3d>& source_centres,
                                const PlanarCompletionOptions& options);

}  // namespace sirpy
