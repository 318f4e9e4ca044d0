// Normals of a depth map that has none.
//
// A pixel's plane is the one that fits the inverse depths (affine over a plane) of a window of 5 x
// 5 pixels best, of the nine such windows that hold the pixel two pixels off or less: at an edge it
// is one on the pixel's own side.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "rectangle.h"

namespace sirpy {

constexpr int kNormalReach = 4;  // pixels around a window that its normals depend on

// `depth` is that of `window` and kNormalReach pixels around it, row-major, 0 where there is none;
// the window is in pixels of the image of `intrinsics` (COLMAP's convention). Returns 3 planes of
// the window: camera frame, unit, towards the camera; along the axis where no window without a gap
// holds the pixel, 0 where it has no depth. The same for any number of threads and for any part of
// the window.
std::vector<float> NormalsOfDepth(const float* depth, const Rectangle& window,
                                  const Eigen::Matrix3d& intrinsics, int threads);

}  // namespace sirpy
