// What counts as a depth: maps of other programs hold negative ones, and numbers that are none.
#pragma once

namespace sirpy {

static inline bool IsDepth(float depth) { return (depth > 1e-30f) & (depth < 1e30f); }

}  // namespace sirpy
