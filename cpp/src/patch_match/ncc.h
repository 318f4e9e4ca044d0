// The cost of one plane in one source: 1 - bilaterally weighted NCC over a 9x9 patch of 25 samples
// (Schoenberger et al., ECCV 2016, section 4.2), the homography linearised at the patch's centre
// (error at its corners, at 60 degrees of slant and rotation: 0.1 px for focal lengths of 1000
// pixels of the level, 0.3 px for 400). A patch that leaves the source, is seen from behind,
// changes its area more than 4 times or reaches farther than kMaxReach in the source costs
// kWorstCost.
//
// The samples of the source are whole numbers: positions are rounded to 1/256 pixel and bilinear
// weights to 1/255, which the 8-bit pixels do not notice (0.001 of a cost). A source's window must
// be less than 2^15 pixels wide.
#pragma once

#include "patch_match/patch.h"

namespace sirpy::patch_match::SIRPY_ISA {

constexpr float kMaxReach = 16;         // pixels
constexpr float kRounding = 1.f / 64;   // pixels: more than the rounding of a sample's position
constexpr float kHalfUnit = 1.f / 512;  // pixels: half a unit of the fixed point

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
  const float right = source.x0 + float(source.width - 1);
  const float bottom = source.y0 + float(source.height - 1);
  warp.inside = (depth > 1e-6f) & (plane.rho > 0.f) & (area > 0.25f) & (area < 4.f) &
                (reach_x <= kMaxReach) & (reach_y <= kMaxReach) &
                (x - reach_x >= source.x0 + kRounding) & (x + reach_x < right) &
                (y - reach_y >= source.y0 + kRounding) & (y + reach_y < bottom);
  return warp;
}

// A position or a step in 1/256 pixels, rounded: x in the low and y in the high half of each lane.
SIRPY_INLINE Halves FixedPoint(Floats x, Floats y) {
  const float shift = 3 << 22;  // leaves the nearest whole number in the low bits of a float
  return (Halves)(((Words)(x * 256.f + shift) & 0xffffu) | (Words)(y * 256.f + shift) << 16);
}

// The bilinear mean of the bytes of a quad, times 255^2; `at` is a position in fixed point. The
// fraction f of 256 counts as f / 255, so that the weights f and 255 - f are bytes.
SIRPY_INLINE Floats Interpolated(Words quad, Halves at) {
  const Words across = RepeatByte<0, 0x01010101>((Words)at) ^ 0x00ff00ffu;  // left, right, twice
  const Words down = RepeatByte<2, 0x00010001>((Words)at) ^ 0x000000ffu;    // upper, lower
  return ToFloats(SumOfProducts(SumsOfByteProducts(across, quad), (Halves)down));
}

SIRPY_FUNCTION Floats NccCost(const Level& level, const Group& group, int j, const Warp& warp) {
  if (!Any(warp.inside)) return Splat(kWorstCost);
  const SourceLevel& source = level.sources[j];
  // Lanes outside read the window's first pixel: harmless, and thrown away below.
  const Floats x = Select(warp.inside, warp.x, Floats{}), y = Select(warp.inside, warp.y, Floats{});
  const Ints whole_x = Truncate(x), whole_y = Truncate(y);
  // Rounded down, since f / 255 is a little more than f / 256: without bias together.
  const Halves centre =
      FixedPoint(x - ToFloats(whole_x) - kHalfUnit, y - ToFloats(whole_y) - kHalfUnit);
  Halves rows[kSide], columns[kSide];
  for (int i = 0; i <= kSide / 2; ++i) {
    const float d = float(i * kPatchStep);
    const Halves row = FixedPoint(d * warp.j01, d * warp.j11) & (Halves)warp.inside;
    const Halves column = FixedPoint(d * warp.j00, d * warp.j10) & (Halves)warp.inside;
    rows[kSide / 2 - i] = centre - row;
    rows[kSide / 2 + i] = centre + row;
    columns[kSide / 2 - i] = -column;
    columns[kSide / 2 + i] = column;
  }

  // All loads before all arithmetic, so that many are under way at once.
  Halves at[kSamples];
  Words quads[kSamples];
  const Ints first = whole_y * source.width + whole_x;
  const Halves strides = (Halves)SplatInt(source.width << 16 | 1);
#pragma GCC unroll 25
  for (int i = 0; i < kSamples; ++i) {
    at[i] = rows[i / kSide] + columns[i % kSide];
    quads[i] = (Words)Gather(source.quads, first + SumOfProducts(at[i] >> 8, strides));
  }
  Floats sum_s{}, sum_ss{}, sum_rs{};
#pragma GCC unroll 5
  for (int i = 0; i < kSamples; ++i) {
    const Floats s = Interpolated(quads[i], at[i]);
    const Floats ws = group.weight[i] * s;
    sum_s += ws;
    sum_ss += ws * s;
    sum_rs += group.centred[i] * s;
  }
  constexpr float kUnit = 1.f / (255 * 255);
  const Floats spread = (sum_ss - sum_s * sum_s * group.inverse_weight_sum) * (kUnit * kUnit);
  // Below the noise of 8-bit rounding (variance 1/12) there is nothing to compare.
  const Floats least = group.weight_sum * (1.f / 12.f);
  const Ints textured = (spread > least) & (group.spread > least);
  const Floats product = Select(textured, group.spread * spread, Splat(1));
  const Floats ncc = sum_rs * kUnit / Sqrt(product);
  const Floats cost = Min(Max(1.f - ncc, Splat(0)), Splat(kWorstCost));
  return Select(warp.inside, Select(textured, cost, Splat(1)), Splat(kWorstCost));
}

}  // namespace sirpy::patch_match::SIRPY_ISA
