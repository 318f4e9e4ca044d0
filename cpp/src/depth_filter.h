// What the depths around a pixel say of its own.
//
// Geometry: a window of a native image, row-major; depth is z in the camera (any unit; 0 where
// there is none), normals are 3 planes in the camera frame. Cameras as in patch_match_sir.h. A
// pixel lies on the plane of another when its depth differs from the plane's on its ray by few
// pixels' worth of depth (depth / focal length), or by few standard deviations of both depths,
// which is more where the sources resolve less: however steep the surface, it lies on its own
// plane.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

// Maps of a window; the arrays are not owned.
struct PlaneMap {
  Rectangle window;            // native pixels
  Eigen::Matrix3d intrinsics;  // K of the whole native image
  const float* depth = nullptr;
  const float* normal = nullptr;
  const float* sigma = nullptr;  // standard deviation of the depth; null: exact
};

// Speckles are small islands of depths that no neighbour shares. Two pixels side by side belong
// together when each lies on the plane of the other, within `step`. Components are 4-connected;
// those of fewer than `min_pixels` pixels are speckles (after Hirschmueller, Stereo Processing by
// Semiglobal Matching and Mutual Information, PAMI 2008, section 2.5, who compares disparities).
// One that touches the border of the window is none, whatever it holds: so the answer for a pixel
// at least `min_pixels` from the border is the same in every window.
struct SpeckleOptions {
  double step = 0;         // pixels' worth of depth, or
  double deviations = 0;   // standard deviations, whichever is more
  int64_t min_pixels = 0;  // 0 or 1: there are no speckles

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// 1 for each pixel of a speckle, 0 elsewhere.
std::vector<uint8_t> FindSpeckles(const PlaneMap& map, const SpeckleOptions& options);

// For each pixel: the share (0 .. 1) of the pixels `kCoplanarReach` away from it, across, down and
// diagonally, that lie on its plane, within `kCoplanarStep`. Those outside the window do not count;
// those without depth are not on the plane. 0 where the pixel has no depth.
constexpr int kCoplanarReach = 4;
constexpr double kCoplanarStep = 2;        // pixels' worth of depth, or
constexpr double kCoplanarDeviations = 2;  // standard deviations, whichever is more
std::vector<float> CoplanarShares(const PlaneMap& map);

// The mean of what lies within `radius` across and down, inside the map. Every mean is summed by
// itself: where the map begins changes none that lies whole in it.
std::vector<float> BoxMeans(const float* plane, int64_t width, int64_t height, int64_t radius);

}  // namespace sirpy
