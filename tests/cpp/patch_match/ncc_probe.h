// The matching cost as the kernels compute it, for tests; compiled once for each instruction set.
#pragma once

#include "patch_match/level.h"

namespace sirpy::patch_match {

// The costs of `planes` in source j along one row of the window, and the weighted variance of the
// patches of the reference.
struct RowCosts {
  float* cost;
  float* variance;
};

#define SIRPY_DECLARE(isa)                                                                         \
  namespace isa {                                                                                  \
  void FillRowCosts(const Level& level, const KernelOptions& options, const Planes& planes, int j, \
                    int y, const RowCosts& costs);                                                 \
  }
SIRPY_DECLARE(baseline)
#ifdef SIRPY_X86
SIRPY_DECLARE(avx2)
SIRPY_DECLARE(avx512)
#endif
#undef SIRPY_DECLARE

}  // namespace sirpy::patch_match
