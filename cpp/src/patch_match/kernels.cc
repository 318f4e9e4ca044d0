// The row kernels of the sweep; compiled once for each instruction set with SIRPY_ISA (a namespace)
// and SIRPY_LANES. No standard library here: nothing that the linker could share between
// instruction sets.
#include "patch_match/level.h"
#include "patch_match/ncc.h"
#include "patch_match/propagation.h"
#include "patch_match/random.h"
#include "patch_match/views.h"

namespace sirpy::patch_match::SIRPY_ISA {

constexpr float kRejected = 3 * kWorstCost;  // worse than any plane that can be compared
constexpr float kLeastCosine = 0.14f;        // planes seen at more than 82 degrees are refused

// Planes inside the depth range that face the camera less obliquely than kLeastCosine. The normal
// is along K^T m, m the plane's coefficients of inverse depth: (fx gx, fy gy, rho at the principal
// point).
SIRPY_INLINE Ints IsPossible(const Level& level, const Group& group, const Plane& plane) {
  const Floats dx = group.x - level.cx, dy = group.native_y - level.cy;
  const Floats nx = level.fx * plane.gx, ny = level.fy * plane.gy;
  const Floats nz = plane.rho - plane.gx * dx - plane.gy * dy;
  const Floats rx = dx * (1.f / level.fx), ry = dy * (1.f / level.fy);
  const Floats limit =
      kLeastCosine * kLeastCosine * (nx * nx + ny * ny + nz * nz) * (rx * rx + ry * ry + 1.f);
  return (plane.rho >= level.min_inverse_depth) & (plane.rho <= level.max_inverse_depth) &
         (plane.rho * plane.rho > limit);
}

// Where there is little texture the coarser level, which saw a wider neighbourhood, has its say: a
// deviation from it costs in place of the NCC (after OpenMVS, Cernea 2020).
SIRPY_INLINE Floats WithPrior(const Level& level, const KernelOptions& options, const Group& group,
                              const Plane& plane, Floats cost, Floats shift) {
  if (!level.prior) return cost;
  Floats prior;
  for (int lane = 0; lane < kLanes; ++lane) {
    prior[lane] = level.prior[int64_t(group.y) * level.width + group.column[lane]];
  }
  const Floats variance = group.spread / group.weight_sum;
  const Floats trust = Exp(variance * (-1.f / options.prior_variance));
  const Floats deviation =
      Select(shift > 0.f, Min(Abs(plane.rho - prior) * shift * (1.f / 3.f), Splat(1)), Splat(1));
  return Select(prior > 0.f, cost + trust * (deviation - cost), cost);
}

// The NCC costs of a plane in every source.
SIRPY_FUNCTION void SourceCosts(const Level& level, const Group& group, const Plane& plane,
                                Floats costs[kMaxSources]) {
  for (int j = 0; j < level.num_sources; ++j) {
    costs[j] = NccCost(level, group, j, WarpPatch(level, group, j, plane));
  }
}

struct Cost {
  Floats value;
  Floats shift;  // pixels of motion in the sources per unit of inverse depth, their mean
};

// The cost of a plane: the weighted mean over the used sources of the NCC cost (of `known`, where
// they have been computed) and, where sources have depths, of their disagreement.
SIRPY_FUNCTION Cost PlaneCost(const Level& level, const KernelOptions& options, const Group& group,
                              const ViewWeights& views, const Plane& plane,
                              const Floats* known = nullptr) {
  Floats photometric{}, geometric{}, shift{}, weights{}, seen{};
  for (int j = 0; j < level.num_sources; ++j) {
    if (!views.any[j]) continue;
    const Warp warp = WarpPatch(level, group, j, plane);
    photometric += views.weight[j] * (known ? known[j] : NccCost(level, group, j, warp));
    if (level.sources[j].inverse_depth) {
      const Floats error = ForwardBackwardError(level, group, j, warp);
      const Floats most = Splat(options.max_geometric_error);
      geometric += views.weight[j] * Select(error < 0.f, most, Min(error, most));
    }
    shift += views.weight[j] * Select(warp.inside, warp.shift, Floats{});
    seen += Select(warp.inside, views.weight[j], Floats{});
    weights += views.weight[j];
  }
  const Ints compared = weights > 0.f;
  const Floats scale = 1.f / Select(compared, weights, Splat(1));
  Cost cost;
  cost.shift = shift / Select(seen > 0.f, seen, Splat(1));  // 0 where no source sees the patch
  const Floats ncc = Select(compared, photometric * scale, Splat(kWorstCost));
  cost.value = WithPrior(level, options, group, plane, ncc, cost.shift) +
               options.geometric_weight * geometric * scale;
  cost.value = Select(IsPossible(level, group, plane), cost.value, Splat(kRejected));
  return cost;
}

// Replaces the best plane in the lanes where `plane` is better.
SIRPY_INLINE void Keep(Ints better, const Plane& plane, const Cost& cost, Plane* best,
                       Cost* best_cost) {
  best->rho = Select(better, plane.rho, best->rho);
  best->gx = Select(better, plane.gx, best->gx);
  best->gy = Select(better, plane.gy, best->gy);
  best_cost->value = Select(better, cost.value, best_cost->value);
  best_cost->shift = Select(better, cost.shift, best_cost->shift);
}

SIRPY_INLINE void Store(const Level& level, const Group& group, const Plane& plane, Floats cost,
                        const ViewWeights* views, Planes* planes) {
  for (int lane = 0; lane < group.count; ++lane) {
    const int64_t at = int64_t(group.y) * level.width + group.column[lane];
    planes->rho[at] = plane.rho[lane];
    planes->gx[at] = plane.gx[lane];
    planes->gy[at] = plane.gy[lane];
    planes->cost[at] = cost[lane];
    if (!views) continue;
    uint16_t mask = 0;
    for (int j = 0; j < level.num_sources; ++j) mask |= uint16_t((views->used[j][lane] & 1) << j);
    planes->views[at] = mask;
  }
}

SIRPY_INLINE ViewWeights StoredViews(const Level& level, const Planes& planes, const Group& group) {
  ViewWeights views;
  for (int j = 0; j < level.num_sources; ++j) {
    for (int lane = 0; lane < kLanes; ++lane) {
      const int64_t at = int64_t(group.y) * level.width + group.column[lane];
      views.used[j][lane] = (planes.views[at] >> j & 1) ? -1 : 0;
    }
    views.weight[j] = Select(views.used[j], Splat(1), Floats{});
    views.any[j] = Any(views.used[j]);
  }
  return views;
}

// Random numbers of the group's pixels for one draw.
SIRPY_INLINE Floats Draw(const Level& level, const Group& group, int iteration, int draw) {
  Floats value;
  const uint64_t what = uint64_t(level.level) << 32 | uint64_t(iteration) << 16 | uint64_t(draw);
  for (int lane = 0; lane < kLanes; ++lane) {
    const uint64_t pixel =
        uint64_t(uint32_t(level.y0 + group.y)) << 32 | uint32_t(level.x0 + group.column[lane]);
    value[lane] = Uniform(Hash(level.seed, pixel, what));
  }
  return value;
}

// A step of random sign whose size is log-uniform in [least, most].
SIRPY_INLINE Floats LogUniform(Floats uniform, float least, float most) {
  const Floats folded = Abs(2.f * uniform - 1.f);
  const Floats size = least * Exp(folded * __builtin_logf(most / least));
  return Select(uniform < 0.5f, -size, size);
}

// Candidates of the initialisation: for each pixel of the row the plane of `candidates` replaces
// the present one where it costs less. Without neighbours to ask, a plane is judged by the sources
// that it looks best in.
void EvaluateRow(const Level& level, const KernelOptions& options, const Planes& candidates,
                 Planes* planes, int y) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      Plane plane;
      for (int lane = 0; lane < kLanes; ++lane) {
        plane.rho[lane] = candidates.rho[group.column[lane]];
        plane.gx[lane] = candidates.gx[group.column[lane]];
        plane.gy[lane] = candidates.gy[group.column[lane]];
      }
      Floats costs[kMaxSources];
      SourceCosts(level, group, plane, costs);
      ViewWeights views = BestViews(level.num_sources, 3, costs);
      const Cost cost = PlaneCost(level, options, group, views, plane, costs);
      Plane best = LoadPlanes(level, *planes, group);
      Floats present{};
      for (int lane = 0; lane < kLanes; ++lane) {
        present[lane] = planes->cost[int64_t(y) * level.width + group.column[lane]];
      }
      Cost best_cost{present, Floats{}};
      const Ints better = (cost.value < kRejected) & (cost.value < best_cost.value);
      Keep(better, plane, cost, &best, &best_cost);
      const ViewWeights before = StoredViews(level, *planes, group);
      for (int j = 0; j < level.num_sources; ++j) {
        views.used[j] = (better & views.used[j]) | (~better & before.used[j]);
      }
      Store(level, group, best, best_cost.value, &views, planes);
    }
  }
}

// Steps are sizes in source pixels, so they suit any focal length, baseline and height.
SIRPY_INLINE void Refine(const Level& level, const KernelOptions& options, const Planes& planes,
                         const Group& group, const ViewWeights& views, int iteration, Plane* best,
                         Cost* best_cost) {
  const float largest = (level.coarsest ? 8.f : 2.f) / float(1 << (iteration < 4 ? iteration : 4));
  const auto attempt = [&](const Plane& plane) {
    const Cost cost = PlaneCost(level, options, group, views, plane);
    Keep(cost.value < best_cost->value, plane, cost, best, best_cost);
  };
  const auto draw = [&](int number) { return Draw(level, group, iteration, number); };
  const auto with_step = [&](Plane plane, int number) {
    plane.rho += LogUniform(draw(number), 0.1f, largest) / Max(best_cost->shift, Splat(1e-20f));
    return plane;
  };
  const auto with_tilt = [&](Plane plane,
                             int number) {  // the patch's corner moves by 0.05 to 2 pixels
    const Floats tilt = (1.f / kPatchRadius) / Max(best_cost->shift, Splat(1e-20f));
    plane.gx += LogUniform(draw(number), 0.05f, 2) * tilt;
    plane.gy += LogUniform(draw(number + 1), 0.05f, 2) * tilt;
    return plane;
  };
  attempt(with_step(*best, 0));
  attempt(with_tilt(*best, 1));
  attempt(with_tilt(with_step(*best, 3), 4));
  attempt(WithNeighbourSlope(level, planes, group, *best));
  if (level.coarsest && iteration < 2) {
    Plane anywhere = *best;
    anywhere.rho =
        level.min_inverse_depth + draw(6) * (level.max_inverse_depth - level.min_inverse_depth);
    attempt(anywhere);
  }
}

// Half a sweep over one row: propagate, select views, refine.
void SweepRow(const Level& level, const KernelOptions& options, Planes* planes, int y, int colour,
              int iteration) {
  const int first_of_row = (colour + level.x0 + level.y0 + y) & 1;
  for (int first = first_of_row; first < level.width; first += 2 * kLanes) {
    const Group group = LoadGroup(level, options, first, y);
    const Offers offers = CollectOffers(level, *planes, group, level.offers);
    Floats costs[8][kMaxSources];
    for (int i = 0; i < offers.count; ++i) SourceCosts(level, group, offers.plane[i], costs[i]);
    ViewWeights views =
        SelectViews(level, options, *planes, group, costs, offers.valid, offers.count, iteration);
    Plane best = LoadPlanes(level, *planes, group);
    const Ints none = NoView(level.num_sources, views);
    if (Any(none)) {  // no source pleases the neighbours: those that suit the present plane best
      Floats present[kMaxSources];
      SourceCosts(level, group, best, present);
      Replace(level.num_sources, none, BestViews(level.num_sources, 2, present), &views);
    }
    Cost best_cost = PlaneCost(level, options, group, views, best);
    for (int i = 0; i < offers.count; ++i) {
      const Plane& plane = offers.plane[i];
      const Cost cost = PlaneCost(level, options, group, views, plane, costs[i]);
      Keep(offers.valid[i] & (cost.value < best_cost.value), plane, cost, &best, &best_cost);
    }
    Refine(level, options, *planes, group, views, iteration, &best, &best_cost);
    Store(level, group, best, best_cost.value, &views, planes);
  }
}

// Sub-pixel depth: the vertex of the parabola through the costs half a pixel nearer and farther.
void RefineRow(const Level& level, const KernelOptions& options, Planes* planes, int y) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      const ViewWeights views = StoredViews(level, *planes, group);
      Plane best = LoadPlanes(level, *planes, group);
      Cost cost = PlaneCost(level, options, group, views, best);
      const Floats step = 0.5f / Max(cost.shift, Splat(1e-20f));
      const auto moved = [&](Floats steps) {
        Plane plane = best;
        plane.rho += steps * step;
        return plane;
      };
      const Floats nearer = PlaneCost(level, options, group, views, moved(Splat(1))).value;
      const Floats farther = PlaneCost(level, options, group, views, moved(Splat(-1))).value;
      const Floats curvature = nearer - 2.f * cost.value + farther;
      const Ints convex = curvature > 1e-6f;
      const Floats offset = 0.5f * (farther - nearer) / Select(convex, curvature, Splat(1));
      const Plane vertex = moved(Min(Max(offset, Splat(-1)), Splat(1)));
      const Cost vertex_cost = PlaneCost(level, options, group, views, vertex);
      Keep(convex & (vertex_cost.value < cost.value), vertex, vertex_cost, &best, &cost);
      Store(level, group, best, cost.value, nullptr, planes);
    }
  }
}

void AssessRow(const Level& level, const KernelOptions& options, const Planes& planes,
               Assessment* assessment, int y) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      const ViewWeights views = StoredViews(level, planes, group);
      const Plane plane = LoadPlanes(level, planes, group);
      Floats sum{}, weights{}, seeing{}, consistent{};
      for (int j = 0; j < level.num_sources; ++j) {
        const Warp warp = WarpPatch(level, group, j, plane);
        seeing += Select(warp.inside, Splat(1), Floats{});
        if (views.any[j]) {
          sum += views.weight[j] * NccCost(level, group, j, warp);
          weights += views.weight[j];
        }
        if (level.sources[j].inverse_depth) {
          const Floats error = ForwardBackwardError(level, group, j, warp);
          consistent += Select((error >= 0.f) & (error < options.consistency), Splat(1), Floats{});
        }
      }
      const Floats cost = Select(weights > 0.f, sum / Max(weights, Splat(1)), Splat(kWorstCost));
      for (int lane = 0; lane < group.count; ++lane) {
        const int64_t at = int64_t(y) * level.width + group.column[lane];
        assessment->cost[at] = cost[lane];
        assessment->num_seeing[at] = uint8_t(seeing[lane]);
        assessment->num_consistent[at] = uint8_t(consistent[lane]);
      }
    }
  }
}

#define SIRPY_STRING_(x) #x
#define SIRPY_STRING(x) SIRPY_STRING_(x)
extern const Kernels kKernels;
const Kernels kKernels = {SIRPY_STRING(SIRPY_ISA), EvaluateRow, SweepRow, RefineRow, AssessRow};

}  // namespace sirpy::patch_match::SIRPY_ISA
