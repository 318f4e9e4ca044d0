// PatchMatch multi-view stereo for one window of a native image and windows of its sources.
//
// Geometry: PINHOLE cameras in COLMAP's convention (the centre of the top-left pixel of the native
// image is at (0.5, 0.5), x right, y down, cam_from_world); intrinsics are those of the whole
// undistorted native image, windows are rectangles of its pixels. Depth is z in the reference
// camera.
//
// Method: slanted planes with adaptive checkerboard propagation and joint view selection (Xu and
// Tao, ACMM, CVPR 2019), bilaterally weighted NCC and geometric consistency (Schoenberger et al.,
// ECCV 2016), refinement in steps of source pixels, coarse to native. Everything depends on native
// pixels alone: the result does not change with the number of threads, and windows of any grid see
// the same random numbers.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

struct PatchMatchOptions {
  double min_depth = 0;  // depth range of the reference window; z, world units
  double max_depth = 0;
  int levels = 3;  // of the pyramid; each halves the size; windows start at multiples of
                   // 2^(levels - 1) pixels
  int coarsest_iterations = 4;   // sweeps at the coarsest level
  int middle_iterations = 3;     // at levels between
  int native_iterations = 1;     // at native resolution
  int geometric_iterations = 2;  // in the geometric pass
  int native_offers =
      5;              // planes of neighbours that a pixel tries there, of 8; all at coarser levels
  int top_views = 4;  // sources that a pixel is matched against, at most
  double color_sigma = 20;         // grey levels: bilateral weight
  double space_sigma = 3;          // pixels: bilateral weight
  double geometric_weight = 0.2;   // cost of one pixel of disagreement with a source's depth
  double max_geometric_error = 3;  // pixels
  double consistency = 1;          // pixels: two depth maps agree
  double prior_variance = 4;  // grey levels squared: below this texture the coarser level counts
  uint64_t seed = 0;          // of the run, the native image and the pass
  int threads = 0;            // 0: one for each core

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// A window of a native image; the arrays are not owned and hold rectangle.height x rectangle.width
// pixels.
struct ViewWindow {
  Eigen::Matrix3d intrinsics;  // K of the whole native image
  Eigen::Matrix3d rotation;    // cam_from_world
  Eigen::Vector3d translation;
  Rectangle rectangle;  // native pixels
  const uint8_t* grey = nullptr;
  const float* depth =
      nullptr;  // of the previous pass; 0 where there is none; null: photometric pass
  const float* normal = nullptr;  // 3 planes, camera frame; read from the reference only
};

// A sparse point seen in the reference: native pixel coordinates and depth.
struct SparsePoint {
  double x, y, depth;
};

// Maps of the reference window, row-major.
struct PatchMatchResult {
  std::vector<float> depth;             // 0 where nothing could be compared
  std::vector<float> normal;            // 3 planes, camera frame, towards the camera
  std::vector<float> cost;              // 1 - NCC over the selected sources
  std::vector<uint8_t> num_seeing;      // sources whose window holds the patch
  std::vector<uint8_t> num_consistent;  // sources whose depth agrees (geometric pass)
};

// With depths in the sources this is the geometric pass: it starts from the reference's own depth
// and normal and works at native resolution alone. Throws std::invalid_argument for windows,
// cameras or options that make no sense.
PatchMatchResult PatchMatchSir(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                               const std::vector<SparsePoint>& points,
                               const PatchMatchOptions& options);

// Bytes per reference pixel and per pixel of one source window at the peak, without what the caller
// holds.
struct PatchMatchMemory {
  int per_reference_pixel;
  int per_source_pixel;
};
PatchMatchMemory PatchMatchBytesPerPixel(bool geometric);

}  // namespace sirpy
