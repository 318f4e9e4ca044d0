// Fusion of depth maps into points, stateless: what a pixel gives depends on its own depth and on
// the depths of its sources, so any order, any number of workers and any grid give the same points.
//
// Geometry: as patch_match_sir.h. A point lies on the ray of its pixel's centre ((x + 0.5, y + 0.5)
// in COLMAP's coordinates; COLMAP's own fusion uses (x, y), half a pixel off).
//
// A depth is believed when the depths of enough sources agree: forward-backward error below
// `consistency` pixels (Schoenberger et al., ECCV 2016, section 4.6). The point is the mean of what
// the agreeing views measure along the ray. A surface that several views see is emitted by one of
// them: the view of the lowest rank that agrees well and whose pixels are not much coarser there.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

struct FusionOptions {
  int min_consistent = 2;  // sources that must agree; all where fewer are allowed
  double consistency = 1;  // pixels, forward-backward
  double yield_shift =
      0.5;  // pixels: a pixel leaves its point to a view that agrees better than this
  double yield_footprint =
      1.5;  // and whose pixel covers at most this times its area of the surface
  bool keep_duplicates = false;  // every believed pixel emits its point
  int threads = 0;               // 0: one for each core

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// A window of depths of a native image. Arrays are not owned, rectangle.height x rectangle.width,
// row-major.
struct DepthView {
  Eigen::Matrix3d intrinsics;  // K of the whole native image, COLMAP's convention
  Eigen::Matrix3d rotation;    // cam_from_world
  Eigen::Vector3d translation;
  Rectangle rectangle;
  int rank = 0;                  // of the native image: the lower emits
  const float* depth = nullptr;  // 0 where there is none; null: a source that nothing is needed of
};

// Which sources count in the blocks of the reference: row-major, from the corner of the native
// image. A pixel never depends on what its window happens to hold.
struct SourceBlocks {
  int side = 0;  // native pixels
  int columns = 0;
  int rows = 0;
  const uint32_t* allowed = nullptr;  // bit j: source j
};

// The points of a reference window, in row-major order of its pixels.
struct FusedPoints {
  std::vector<double> position;    // 3 per point, world
  std::vector<float> normal;       // 3 per point, world, unit, towards the camera
  std::vector<int64_t> pixel;      // index in the reference window
  std::vector<uint8_t> num_views;  // views that agree, with the reference
  int64_t num_inconsistent = 0;    // pixels with a depth that too few sources confirm
  int64_t num_yielded = 0;         // pixels whose point another view emits
};

// `normal`: 3 planes of the reference window, camera frame. At most 32 sources. Throws
// std::invalid_argument.
FusedPoints Fuse(const DepthView& reference, const float* normal,
                 const std::vector<DepthView>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options);

}  // namespace sirpy
