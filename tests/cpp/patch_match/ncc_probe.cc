#include "ncc_probe.h"

#include "patch_match/ncc.h"

namespace sirpy::patch_match::SIRPY_ISA {

void FillRowCosts(const Level& level, const KernelOptions& options, const Planes& planes, int j,
                  int y, const RowCosts& costs) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      const auto of_group = [&](const float* values) {
        Floats loaded{};
        for (int lane = 0; lane < kLanes; ++lane) {
          loaded[lane] = values[int64_t(y) * level.width + group.column[lane]];
        }
        return loaded;
      };
      const Plane plane{of_group(planes.rho), of_group(planes.gx), of_group(planes.gy)};
      const Floats cost = NccCost(level, group, j, WarpPatch(level, group, j, plane));
      for (int lane = 0; lane < group.count; ++lane) {
        costs.cost[group.column[lane]] = cost[lane];
        costs.variance[group.column[lane]] = group.spread[lane] / group.weight_sum[lane];
      }
    }
  }
}

}  // namespace sirpy::patch_match::SIRPY_ISA
