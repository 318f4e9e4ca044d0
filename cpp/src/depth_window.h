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
  // Without branches, for loops whose pixels fill lanes.
  const int ix = int(x), iy = int(y);
  const float fx = x - float(ix), fy = y - float(iy);
  const int64_t first = int64_t(iy) * width + ix;
  const float a = rho[first], b = rho[first + 1], c = rho[first + width],
              d = rho[first + width + 1];
  const float upper = fx >= 0.5f ? b : a, lower = fx >= 0.5f ? d : c;
  const float nearest = fy < 0.5f ? upper : lower;
  const float close = 0.01f * nearest;
  const bool one_surface =
      (__builtin_fabsf(a - nearest) < close) & (__builtin_fabsf(b - nearest) < close) &
      (__builtin_fabsf(c - nearest) < close) & (__builtin_fabsf(d - nearest) < close);
  const float top = a + fx * (b - a);
  const float bottom = c + fx * (d - c);
  const float between = top + fy * (bottom - top);
  return one_surface ? between : nearest;
}

}  // namespace sirpy
