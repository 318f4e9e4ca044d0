// The cost of one plane in one source: 1 - bilaterally weighted NCC over a 9x9 patch of 25 samples
// (Schoenberger et al., ECCV 2016, section 4.2), the homography linearised at the patch's centre
// (error below 0.1 px at 60 degrees of slant and rotation). A patch that leaves the source's
// window, is seen from behind or changes its area more than 4 times costs kWorstCost.
#pragma once

#include "patch_match/patch.h"

namespace sirpy::patch_match::SIRPY_ISA {

struct Warp {
  Ints inside;
  Floats x, y;   // patch centre in the source's window, pixels
  Floats shift;  // pixels of motion in the source per unit of inverse depth
  Floats j00, j01, j10, j11;
};

SIRPY_INLINE Warp WarpPatch(const Level& level, const Group& group, int j, const Plane& plane) {
  const SourceLevel& source = level.sources[j];
  const float bx = float(source.b[0]), by = float(source.b[1]), bz = float(source.b[2]);
  Warp warp;
  const Floats depth = group.az[j] + bz * plane.rho;  // of the point in the source, times rho
  const Floats inverse = 1.f / depth;
  const Floats x = (group.ax[j] + bx * plane.rho) * inverse;
  const Floats y = (group.ay[j] + by * plane.rho) * inverse;
  const Floats hx = float(source.a[6]) + bz * plane.gx, hy = float(source.a[7]) + bz * plane.gy;
  warp.j00 = (float(source.a[0]) + bx * plane.gx - x * hx) * inverse;
  warp.j01 = (float(source.a[1]) + bx * plane.gy - x * hy) * inverse;
  warp.j10 = (float(source.a[3]) + by * plane.gx - y * hx) * inverse;
  warp.j11 = (float(source.a[4]) + by * plane.gy - y * hy) * inverse;
  const Floats sx = (bx - x * bz) * inverse, sy = (by - y * bz) * inverse;
  warp.shift = Sqrt(sx * sx + sy * sy);
  warp.x = x - source.x0;
  warp.y = y - source.y0;

  const Floats reach_x = float(kPatchRadius) * (Abs(warp.j00) + Abs(warp.j01));
  const Floats reach_y = float(kPatchRadius) * (Abs(warp.j10) + Abs(warp.j11));
  const Floats area = warp.j00 * warp.j11 - warp.j01 * warp.j10;
  warp.inside = (depth > 1e-6f) & (plane.rho > 0.f) & (area > 0.25f) & (area < 4.f) &
                (warp.x - reach_x >= 0.f) & (warp.y - reach_y >= 0.f) &
                (warp.x + reach_x < float(source.width - 1)) &
                (warp.y + reach_y < float(source.height - 1));
  return warp;
}

SIRPY_FUNCTION Floats NccCost(const Level& level, const Group& group, int j, const Warp& warp) {
  if (!Any(warp.inside)) return Splat(kWorstCost);
  const SourceLevel& source = level.sources[j];
  const Floats zero{};
  // Lanes outside read the window's first pixel: harmless, and thrown away below.
  const Floats x = Select(warp.inside, warp.x, zero), y = Select(warp.inside, warp.y, zero);
  const Floats j00 = Select(warp.inside, warp.j00, zero), j01 = Select(warp.inside, warp.j01, zero);
  const Floats j10 = Select(warp.inside, warp.j10, zero), j11 = Select(warp.inside, warp.j11, zero);

  Floats sum_s{}, sum_ss{}, sum_rs{};
  for (int row = 0; row < kSide; ++row) {
    const float dy = float(row * kPatchStep - kPatchRadius);
    const Floats row_x = x + j01 * dy, row_y = y + j11 * dy;
#pragma GCC unroll 5
    for (int column = 0; column < kSide; ++column) {
      const float dx = float(column * kPatchStep - kPatchRadius);
      const Floats px = row_x + j00 * dx, py = row_y + j10 * dx;
      const Ints ix = Truncate(px), iy = Truncate(py);
      const Floats fx = px - ToFloats(ix), fy = py - ToFloats(iy);
      const Words quad = (Words)Gather(source.quads, iy * source.width + ix);
      const Floats v00 = ToFloats((Ints)(quad & 255u));
      const Floats v10 = ToFloats((Ints)((quad >> 8) & 255u));
      const Floats v01 = ToFloats((Ints)((quad >> 16) & 255u));
      const Floats v11 = ToFloats((Ints)(quad >> 24));
      const Floats top = v00 + fx * (v10 - v00), bottom = v01 + fx * (v11 - v01);
      // About the reference's mean, so that float32 does not cancel in the variance.
      const Floats s = top + fy * (bottom - top) - group.mean;
      const Floats ws = group.weight[row * kSide + column] * s;
      sum_s += ws;
      sum_ss += ws * s;
      sum_rs += group.centred[row * kSide + column] * s;
    }
  }
  const Floats spread = sum_ss - sum_s * sum_s / group.weight_sum;
  // Below the noise of 8-bit rounding (variance 1/12) there is nothing to compare.
  const Floats least = group.weight_sum * (1.f / 12.f);
  const Ints textured = (spread > least) & (group.spread > least);
  const Floats product = Select(textured, group.spread * spread, Splat(1));
  const Floats cost = Min(Max(1.f - sum_rs / Sqrt(product), Splat(0)), Splat(kWorstCost));
  return Select(warp.inside, Select(textured, cost, Splat(1)), Splat(kWorstCost));
}

}  // namespace sirpy::patch_match::SIRPY_ISA
