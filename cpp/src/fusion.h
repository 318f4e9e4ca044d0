// Fusion of depth maps into points, stateless: what a pixel gives depends on its own depth and on
// the depths of its sources, so any order, any number of workers and any grid give the same points.
//
// Geometry: as patch_match_sir.h. A point lies on the ray of its pixel's centre ((x + 0.5, y + 0.5)
// in COLMAP's coordinates; COLMAP's own fusion uses (x, y), half a pixel off).
//
// A depth is believed when the depths of enough of the sources that see it agree: forward-backward
// error below `consistency` pixels (Schoenberger et al., ECCV 2016, section 4.6), or of one source
// more below `agreement` standard deviations, and fewer see through it. The point is the mean of
// what the agreeing views measure along the ray, weighted by their variances. A surface that
// several views see is emitted by the one whose pixels are the smallest on it, which is a matter of
// distance and angle, unless another knows it much better.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

struct FusionOptions {
  int min_consistent = 2;  // sources that must agree; all where fewer see the place
  double consistency = 1;  // pixels, forward-backward, or
  double agreement = 1;    // standard deviations, whichever is more
  double yield_shift =
      0.5;  // pixels: a pixel leaves its point to a view that agrees better than this
  double yield_footprint =
      1.5;                 // and whose pixel covers at most this times its area of the surface
  double see_through = 4;  // pixels of parallax by which a source looks past a wrong point
  bool keep_duplicates = false;  // every believed pixel emits its point
  bool thin = false;             // depths of coarser levels give one point for each pixel of theirs
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
  const float* sigma = nullptr;  // standard deviation of the depth; null: all are equally sure
};

// Which sources count in the blocks of the reference: row-major, from the corner of the native
// image. A pixel never depends on what its window happens to hold.
struct SourceBlocks {
  int side = 0;  // native pixels
  int columns = 0;
  int rows = 0;
  const uint32_t* allowed = nullptr;  // bit j: source j
};

// What belongs to the depths of a reference window. Arrays are not owned.
struct ReferenceMaps {
  const float* normal = nullptr;      // 3 planes, camera frame
  const uint8_t* color = nullptr;     // red, green, blue of each pixel; null: points are black
  const float* confidence = nullptr;  // 0 to 1; null: 0
  const uint8_t* level = nullptr;     // of the pixels that a depth comes from; null: 0
};

// A point as it is kept in files: POINT of python/sirpy/cloud.py, without gaps.
struct FusedPoint {
  double position[3];  // world
  float normal[3];     // world, unit, towards the camera
  uint8_t color[3];
  uint8_t num_views;  // that agree, with the reference
  float confidence;
  float gsd;      // side of the pixel on a surface that faces the camera, world units
  float sigma;    // standard deviation along the ray, world units; 0 where it is not known
  int32_t level;  // of the pixels that the depth comes from
};
static_assert(sizeof(FusedPoint) == 56, "a record without gaps");

// The points of a reference window, in row-major order of its pixels.
struct FusedPoints {
  std::vector<FusedPoint> points;
  std::vector<int64_t> pixel;    // of each, index in the reference window
  int64_t num_invalid = 0;       // pixels that hold neither 0 nor a depth
  int64_t num_inconsistent = 0;  // pixels with a depth that too few sources confirm
  int64_t num_seen_through = 0;  // pixels behind whose depth more sources look than confirm it
  int64_t num_yielded = 0;       // pixels whose point another view emits
};

// At most 32 sources. Throws std::invalid_argument.
FusedPoints Fuse(const DepthView& reference, const ReferenceMaps& maps,
                 const std::vector<DepthView>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options);

}  // namespace sirpy
