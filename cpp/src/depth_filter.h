// Speckles of a depth map: small islands of depths that no neighbour shares.
//
// Geometry: a window of depths (z, any unit; 0 where there is none), row-major. Two pixels side by
// side belong together when their depths differ by at most `step_x` (below each other: `step_y`)
// times the nearer of the two. Components are 4-connected. One that touches the border of the
// window counts as large, whatever it holds: so the answer for a pixel at least `min_pixels` from
// the border is the same in every window.
//
// A component is small when it has fewer than `min_pixels` pixels (Hirschmueller, Stereo Processing
// by Semiglobal Matching and Mutual Information, PAMI 2008, section 2.5).
#pragma once

#include <cstdint>
#include <vector>

namespace sirpy {

struct SpeckleOptions {
  double step_x = 0;       // share of the depth
  double step_y = 0;       // share of the depth
  int64_t min_pixels = 0;  // 0 or 1: there are no speckles

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

// 1 for each pixel of a speckle, 0 elsewhere; width * height of them.
std::vector<uint8_t> FindSpeckles(const float* depth, int64_t width, int64_t height,
                                  const SpeckleOptions& options);

}  // namespace sirpy
