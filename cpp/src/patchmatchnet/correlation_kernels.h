// The inner loops of the group-wise correlation. Compiled once for each instruction set; all of
// them give the same bytes.
#pragma once

#include <cstdint>

namespace sirpy::patchmatchnet {

constexpr int kBlock = 16;         // pixels of a row that are worked on at once
constexpr int kChannelUnit = 16;   // channels are a multiple of it,
constexpr int kGroupUnit = 4;      // those of a group of this
constexpr float kNearest = 1e-3f;  // z in the source: what is nearer, or behind, is not seen

// Maps as in group_correlation.h.
struct Correlation {
  const float* reference;
  const float* source;
  const float* depth;
  float* found;     // groups x hypotheses x height x width
  float* products;  // kBlock x channels, for the kernel's own use
  float source_from_reference[12];
  float behind_u, behind_v;
  int64_t height, width;  // of the reference's rows
  int64_t first_row;
  int64_t hypotheses;
  int64_t channels, groups;
  int32_t source_height, source_width;
};

using Correlate = void (*)(const Correlation& correlation);

}  // namespace sirpy::patchmatchnet
