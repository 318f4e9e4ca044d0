// PatchMatch multi-view stereo: one pass over one window of a native image, at one level of the
// pyramid, against windows of its sources.
//
// Geometry: PINHOLE cameras in COLMAP's convention (the centre of the top-left pixel of the native
// image is at (0.5, 0.5), x right, y down, cam_from_world); intrinsics are those of the whole
// undistorted native image. Level l has pixels of 2^l native ones, counted from the corner of the
// native image; windows are rectangles of pixels of their level. Depth is z in the camera.
//
// Method: slanted planes with adaptive checkerboard propagation and joint view selection (Xu and
// Tao, ACMM, CVPR 2019), bilaterally weighted NCC and geometric consistency (Schoenberger et al.,
// ECCV 2016), refinement in steps of source pixels, coarse to native.
//
// Everything depends on pixels of the native images and on fields over them, never on the window:
// with margins of PatchMatchMargin() around what is kept, the result does not change with the
// window, nor with the number of threads or the instruction set.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

struct PatchMatchOptions {
  int iterations = 2;       // sweeps; 0: the start, of the same level, is judged as it is
  int offers = 8;           // planes of neighbours that a pixel tries, of 8
  double largest_step = 2;  // pixels of motion in the sources: the largest refinement at first
  int top_views = 4;        // sources that a pixel is matched against, at most
  double color_sigma = 20;  // grey levels: bilateral weight
  double space_sigma = 3;   // pixels: bilateral weight
  double geometric_weight = 0.2;   // cost of one pixel of disagreement with a source's depth
  double max_geometric_error = 3;  // pixels
  double consistency = 1;          // pixels: two depth maps agree, and
  double agreement = 2.5;          // standard deviations: the larger of both
  // Grey levels squared: the variance of noise, by 16 steps of brightness. A patch that varies no
  // more keeps the depth of the start.
  std::array<double, 16> noise = {2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2};
  double prior_weight = 0.3;  // of the depth of the start, by its standard deviation
  bool everywhere = false;    // also with a start: depths at random are tried beside it
  uint64_t seed = 0;          // of the run, the native image and the pass
  int threads = 0;            // 0: one for each core

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// A window of a native image; arrays are not owned and hold rectangle.height x rectangle.width
// pixels.
struct ViewWindow {
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();  // K of the whole native image
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();    // cam_from_world
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  int level = 0;        // a source that samples the surface finer is given at a coarser level
  Rectangle rectangle;  // pixels of the level
  const uint8_t* grey = nullptr;  // null: a source that sees nothing of this window
  // Of sources in a geometric pass: 1 / depth, 0 where there is none.
  const float* inverse_depth = nullptr;
  const float* deviation = nullptr;  // standard deviation of the inverse depth; null: exact
};

// What is known of blocks of the reference before it is looked at: row-major, from the corner of
// the native image.
struct ViewBlocks {
  int side = 0;  // native pixels, a multiple of the level's pixel
  int columns = 0;
  int rows = 0;
  const uint32_t* allowed = nullptr;  // bit j: source j may be matched
  const float* min_depth = nullptr;
  const float* max_depth = nullptr;
};

// A sparse point seen in the reference: native pixel coordinates and depth.
struct SparsePoint {
  double x, y, depth;
};

// Where a pass starts: maps of the reference of the pass before, at the same level or one coarser.
// Not owned.
struct StartMaps {
  int level = 0;
  Rectangle rectangle;                // pixels of the level
  const float* depth = nullptr;       // 0 where there is none
  const float* normal = nullptr;      // 3 planes, camera frame
  const uint32_t* views = nullptr;    // bit j: source j was used
  const float* sigma = nullptr;       // standard deviation of the depth; null: not known
  const uint8_t* level_of = nullptr;  // of the pixels that the depth comes from; null with sigma
};

// Maps of the reference window, row-major.
struct PatchMatchResult {
  std::vector<float> depth;             // 0 where nothing could be compared
  std::vector<float> normal;            // 3 planes, camera frame, towards the camera
  std::vector<uint32_t> views;          // bit j: source j is used
  std::vector<float> cost;              // 1 - NCC over the used sources
  std::vector<float> texture;           // variance of the patch, grey levels squared
  std::vector<uint8_t> num_seeing;      // sources whose image holds the patch
  std::vector<uint8_t> num_consistent;  // sources whose depth agrees (geometric pass)
  std::vector<float> sigma;             // standard deviation of the depth
  std::vector<float> motion;            // depth that moves it by a pixel in the sources
  std::vector<uint8_t> level;           // of the pixels that the depth comes from
};

// Without `start` the pass begins from `points` and at random. Throws std::invalid_argument for
// windows, cameras or options that make no sense.
PatchMatchResult PatchMatchSir(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                               const ViewBlocks& blocks, const std::vector<SparsePoint>& points,
                               const StartMaps* start, const PatchMatchOptions& options);

// The domain of dependence: how far from a pixel, in pixels of the level, the reference window can
// change its result.
int PatchMatchMargin(int iterations);

// Bytes at the peak, without what the caller holds: either while planes are matched, or at the end,
// when nothing is held of the sources.
struct PatchMatchMemory {
  int per_reference_pixel;
  int per_source_pixel;
  int per_reference_pixel_at_end;
};
PatchMatchMemory PatchMatchBytesPerPixel();

}  // namespace sirpy
