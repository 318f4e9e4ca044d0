// What ncc.cc times; compiled once for each instruction set.
#include "patch_match/ncc.h"

namespace sirpy::patch_match::SIRPY_ISA {

// The sum of the costs of `planes` of one row in all sources; each plane `repeats` times, nudged by
// less than a pixel.
float SumOfCosts(const Level& level, const KernelOptions& options, const Planes& planes, int y,
                 int repeats) {
  Floats sum{};
  for (int first = 0; first < level.width; first += 2 * kLanes) {
    const Group group = LoadGroup(level, options, first, y);
    const auto of_group = [&](const float* values) {
      Floats loaded{};
      for (int lane = 0; lane < kLanes; ++lane) {
        loaded[lane] = values[int64_t(y) * level.width + group.column[lane]];
      }
      return loaded;
    };
    Plane plane{of_group(planes.rho), of_group(planes.gx), of_group(planes.gy)};
    for (int repeat = 0; repeat < repeats; ++repeat, plane.rho *= 1.00001f) {
      for (int j = 0; j < level.num_sources; ++j) {
        sum += NccCost(level, group, j, WarpPatch(level, group, j, plane));
      }
    }
  }
  float total = 0;
  for (int lane = 0; lane < kLanes; ++lane) total += sum[lane];
  return total;
}

}  // namespace sirpy::patch_match::SIRPY_ISA
