// Agreement with the depths that the sources have found themselves: forward-backward error
// (Schoenberger et al., ECCV 2016, section 4.5).
#pragma once

#include "patch_match/ncc.h"

namespace sirpy::patch_match::SIRPY_ISA {

// Inverse depth in the source at the patch's centre, 0 where there is none: bilinear between pixels
// of one surface (exact on planes, whose inverse depth is affine), the nearest pixel's value where
// the four are more than 1 % apart, as InterpolatedInverseDepth in depth_window.h.
SIRPY_INLINE Floats InverseDepthAt(const SourceLevel& source, Floats x, Floats y) {
  const Ints ix = Truncate(x), iy = Truncate(y);
  const Floats fx = x - ToFloats(ix), fy = y - ToFloats(iy);
  const Ints at = iy * source.width + ix;
  const float* table = source.inverse_depth;
  const Floats v00 = Gather(table, at), v10 = Gather(table, at + 1);
  const Floats v01 = Gather(table, at + source.width), v11 = Gather(table, at + source.width + 1);
  const Ints right = fx >= 0.5f;
  const Floats nearest = Select(fy < 0.5f, Select(right, v10, v00), Select(right, v11, v01));
  const Floats close = 0.01f * nearest;
  const Ints one_surface = (Abs(v00 - nearest) < close) & (Abs(v10 - nearest) < close) &
                           (Abs(v01 - nearest) < close) & (Abs(v11 - nearest) < close);
  const Floats top = v00 + fx * (v10 - v00), bottom = v01 + fx * (v11 - v01);
  return Select(one_surface, top + fy * (bottom - top), nearest);
}

// How far a source's depth is from the reference's, in reference pixels.
struct Disagreement {
  Floats error;   // to the source, onto the depth found there, and back; -1 where there is none
  Floats spread;  // the standard deviation that the source's depth gives it
};

SIRPY_FUNCTION Disagreement ForwardBackward(const Level& level, const Group& group, int j,
                                            const Warp& warp) {
  const SourceLevel& source = level.sources[j];
  const Floats zero{};
  const Floats x = Select(warp.inside, warp.x, zero), y = Select(warp.inside, warp.y, zero);
  const Floats found = InverseDepthAt(source, x, y);
  const Floats u = x + source.x0, v = y + source.y0;
  const double* a = source.back_a;
  const double* b = source.back_b;
  const auto row = [&](int i) {
    return float(a[3 * i]) * u + float(a[3 * i + 1]) * v + float(a[3 * i + 2]) +
           float(b[i]) * found;
  };
  const Floats z = row(2);
  const Ints known = warp.inside & (found > 0.f) & (z > 0.f);
  const Floats inverse = 1.f / Select(known, z, Splat(1));
  const Floats back_x = row(0) * inverse, back_y = row(1) * inverse;
  const Floats dx = back_x - group.x, dy = back_y - group.native_y;
  Disagreement disagreement{Select(known, Sqrt(dx * dx + dy * dy), Splat(-1)), Floats{}};
  if (source.deviation) {
    const Ints at = Truncate(y + 0.5f) * source.width + Truncate(x + 0.5f);
    const Floats sx = (float(b[0]) - back_x * float(b[2])) * inverse;
    const Floats sy = (float(b[1]) - back_y * float(b[2])) * inverse;
    disagreement.spread = Gather(source.deviation, at) * Sqrt(sx * sx + sy * sy);
  }
  return disagreement;
}

}  // namespace sirpy::patch_match::SIRPY_ISA
