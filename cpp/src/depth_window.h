// Reading inverse depth between pixels. `rho` is row-major with 0 where there is none; (x, y) is a
// position in the window with pixel centres at whole numbers, 0 <= x < width - 1, 0 <= y < height -
// 1.
#pragma once

#include <cstdint>

namespace sirpy {

// Bilinear between pixels of one surface (exact on planes, whose inverse depth is affine), the
// nearest pixel's value where the four are more than 1 % apart: interpolating across an edge would
// invent depths.
static inline float InterpolatedInverseDepth(const float* rho, int width, float x, float y) {
  const int ix = int(x), iy = int(y);
  const float fx = x - float(ix), fy = y - float(iy);
  const float* upper = rho + int64_t(iy) * width + ix;
  const float* lower = upper + width;
  const float nearest = fy < 0.5f ? upper[fx >= 0.5f] : lower[fx >= 0.5f];
  const float close = 0.01f * nearest;
  const bool one_surface =
      __builtin_fabsf(upper[0] - nearest) < close && __builtin_fabsf(upper[1] - nearest) < close &&
      __builtin_fabsf(lower[0] - nearest) < close && __builtin_fabsf(lower[1] - nearest) < close;
  if (!one_surface) return nearest;
  const float top = upper[0] + fx * (upper[1] - upper[0]);
  const float bottom = lower[0] + fx * (lower[1] - lower[0]);
  return top + fy * (bottom - top);
}

}  // namespace sirpy
