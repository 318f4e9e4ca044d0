// The reference side of the cost: bilateral weights and moments of the patches of one group of
// pixels. They depend on the reference image alone, so they are computed once for all planes and
// sources.
#pragma once

#include "patch_match/lanes.h"
#include "patch_match/level.h"

namespace sirpy::patch_match::SIRPY_ISA {

constexpr int kSide = 2 * kPatchRadius / kPatchStep + 1;
constexpr int kSamples = kSide * kSide;

struct Plane {
  Floats rho, gx, gy;
};

// kLanes pixels of a row, every second one from `first` on; a lane beyond the window repeats its
// last pixel of the colour, and is never written.
struct Group {
  int y = 0;                 // row in the window
  int count = 0;             // lanes that are inside
  int column[kLanes];        // in the window
  Floats x, native_y;        // position in the native image at this level
  Floats weight[kSamples];   // bilateral, w
  Floats centred[kSamples];  // w (r - mean)
  Floats weight_sum, inverse_weight_sum;
  Floats spread;            // sum of w (r - mean)^2
  Words allowed;            // sources that may be matched; bit j is source j
  Floats min_rho, max_rho;  // range of inverse depth
  Floats ax[kMaxSources], ay[kMaxSources],
      az[kMaxSources];  // a x~ of the allowed sources, without the window's origin
};

SIRPY_FUNCTION Group LoadGroup(const Level& level, const KernelOptions& options, int first, int y) {
  Group group;
  group.y = y;
  group.count = 0;
  const int last = first + (level.width - 1 - first) / 2 * 2;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int x = first + 2 * lane;
    group.count += x <= last;
    group.column[lane] = x <= last ? x : last;
    group.x[lane] = float(level.x0 + group.column[lane]);
  }
  group.native_y = Splat(float(level.y0 + y));

  const int stride = level.width + 2 * kPatchRadius;
  const uint8_t* rows = level.grey + int64_t(y) * stride;
  Floats value[kSamples];
  const bool whole = first + 2 * kLanes <= level.width;
  for (int i = 0; i < kSamples; ++i) {
    const uint8_t* row = rows + int64_t(i / kSide) * kPatchStep * stride + (i % kSide) * kPatchStep;
    if (whole) {
      value[i] = EverySecondByte(row + first);
    } else {
      for (int lane = 0; lane < kLanes; ++lane) value[i][lane] = float(row[group.column[lane]]);
    }
  }
  const float color = -1.f / (2 * options.color_sigma * options.color_sigma);
  const float space = -1.f / (2 * options.space_sigma * options.space_sigma);
  Floats sum{}, first_moment{};
  for (int i = 0; i < kSamples; ++i) {
    const int dx = (i % kSide) * kPatchStep - kPatchRadius;
    const int dy = (i / kSide) * kPatchStep - kPatchRadius;
    const Floats difference = value[i] - value[kSamples / 2];
    group.weight[i] = Exp(difference * difference * color + space * float(dx * dx + dy * dy));
    sum += group.weight[i];
    first_moment += group.weight[i] * value[i];
  }
  group.weight_sum = sum;
  group.inverse_weight_sum = 1.f / sum;
  const Floats mean = first_moment * group.inverse_weight_sum;
  group.spread = Floats{};
  for (int i = 0; i < kSamples; ++i) {
    const Floats deviation = value[i] - mean;
    group.centred[i] = group.weight[i] * deviation;
    group.spread += group.centred[i] * deviation;
  }

  uint32_t any_allowed = 0;
  const Block* block = &level.BlockAt(group.column[0], y);
  const bool one_block = block == &level.BlockAt(group.column[kLanes - 1], y);
  for (int lane = 0; lane < kLanes; ++lane) {
    if (!one_block) block = &level.BlockAt(group.column[lane], y);
    group.allowed[lane] = block->allowed;
    group.min_rho[lane] = block->min_inverse_depth;
    group.max_rho[lane] = block->max_inverse_depth;
    any_allowed |= block->allowed;
  }
  const Doubles px = __builtin_convertvector(group.x, Doubles);
  const double py = double(level.y0) + y;
  for (uint32_t left = any_allowed; left != 0; left &= left - 1) {
    const int j = __builtin_ctz(left);
    const double* a = level.sources[j].a;
    group.ax[j] = __builtin_convertvector(a[0] * px + (a[1] * py + a[2]), Floats);
    group.ay[j] = __builtin_convertvector(a[3] * px + (a[4] * py + a[5]), Floats);
    group.az[j] = __builtin_convertvector(a[6] * px + (a[7] * py + a[8]), Floats);
  }
  return group;
}

}  // namespace sirpy::patch_match::SIRPY_ISA
