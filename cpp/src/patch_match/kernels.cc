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
constexpr float kUnbounded = 1e30f;
constexpr float kIndependentSamples = 8;  // of the 25 of a patch, in each source
constexpr float kLeastDeviation = 0.1f;   // pixels: what likelihood does not know of
constexpr float kLargestDeviation = 4;    // pixels
constexpr float kHeldTrust = 0.5f;        // in the prior: the patch is more noise than signal
constexpr float kLeastCosine = 0.14f;     // planes seen at more than 82 degrees are refused

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
  return (plane.rho >= group.min_rho) & (plane.rho <= group.max_rho) &
         (plane.rho * plane.rho > limit);
}

// Where there is little texture the coarser level, which saw a wider neighbourhood, has its say: a
// deviation from it costs in place of the NCC (after OpenMVS, Cernea 2020).
struct Prior {
  Floats rho;
  Floats deviation;  // standard deviation of rho
  Floats trust;      // in [0, 1]; 0 where nothing is known
};

// Variance that the patches would have without any signal, by the brightness of their centres.
SIRPY_INLINE Floats Noise(const Level& level, const KernelOptions& options, const Group& group) {
  const int stride = level.width + 2 * kPatchRadius;
  const uint8_t* row = level.grey + int64_t(group.y + kPatchRadius) * stride + kPatchRadius;
  Floats noise;
  for (int lane = 0; lane < kLanes; ++lane) {
    noise[lane] = options.noise[row[group.column[lane]] / (256 / kBrightnesses)];
  }
  return noise;
}

SIRPY_INLINE Prior LoadPrior(const Level& level, const KernelOptions& options, const Group& group) {
  Prior prior{};
  if (!level.prior) return prior;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int64_t at = int64_t(group.y) * level.width + group.column[lane];
    prior.rho[lane] = level.prior[at];
    prior.deviation[lane] = level.prior_deviation[at];
  }
  const Floats variance = group.spread / group.weight_sum;
  const Floats ratio = variance / Noise(level, options, group);
  prior.trust = Select(prior.rho > 0.f, Exp(ratio * ratio * -0.7f), Floats{});
  return prior;
}

// The NCC costs of a plane in the sources that each lane may be matched against.
SIRPY_FUNCTION void SourceCosts(const Level& level, const Group& group, const Plane& plane,
                                Floats costs[kMaxSources]) {
  for (Sources j{UnionOf(group.allowed)}; j.more(); j.next()) {
    const Floats cost = NccCost(level, group, *j, WarpPatch(level, group, *j, plane));
    costs[*j] = Select(Has(group.allowed, *j), cost, Splat(kWorstCost));
  }
}

struct Cost {
  Floats value;
  Floats shift;        // pixels of motion in the sources per unit of inverse depth, their mean
  Floats photometric;  // the mean of the NCC costs alone
};

// The cost of a plane: the weighted mean over the used sources of the NCC cost (of `known`, where
// they have been computed) and, where sources have depths, of their disagreement. Costs only grow
// with each source, so the sum ends where no lane can stay below `bound`.
SIRPY_FUNCTION Cost PlaneCost(const Level& level, const KernelOptions& options, const Group& group,
                              const Prior& prior, const ViewWeights& views, const Plane& plane,
                              Floats bound, const Floats* known = nullptr) {
  const Cost rejected{Splat(kRejected), Floats{}, Splat(kWorstCost)};
  const Ints possible = IsPossible(level, group, plane);
  if (!Any(possible)) return rejected;
  Floats weights{}, views_count{};
  for (Sources j{views.any}; j.more(); j.next()) {
    weights += views.weight[*j];
    views_count += Select(views.weight[*j] > 0.f, Splat(1), Floats{});
  }
  const Ints compared = weights > 0.f;
  const Floats scale = 1.f / Select(compared, weights, Splat(1));
  const Floats photometric_scale = (1.f - prior.trust) * scale;
  const Floats geometric_scale = options.geometric_weight * scale;

  Floats value = Select(compared, Floats{}, (1.f - prior.trust) * kWorstCost), shift{}, seen{},
         photometric{};
  for (Sources j{views.any}; j.more(); j.next()) {
    const Floats weight = views.weight[*j];
    const Warp warp = WarpPatch(level, group, *j, plane);
    const Floats ncc_cost = known ? known[*j] : NccCost(level, group, *j, warp);
    value += photometric_scale * weight * ncc_cost;
    photometric += weight * ncc_cost;
    if (level.sources[*j].inverse_depth) {
      const Disagreement found = ForwardBackward(level, group, *j, warp);
      const Floats error = found.error / Max(found.spread, Splat(1));
      const Floats most = Splat(options.max_geometric_error);
      value += geometric_scale * weight * Select(error < 0.f, most, Min(error, most));
    }
    if (!Any(possible & (value < bound))) return rejected;
    shift += weight * Select(warp.inside, warp.shift, Floats{});
    seen += Select(warp.inside, weight, Floats{});
  }
  Cost cost;
  cost.shift = shift / Select(seen > 0.f, seen, Splat(1));  // 0 where no source sees the patch
  const Floats tolerated = Max(3.f * prior.deviation * cost.shift, Splat(1));  // pixels of motion
  const Floats deviation =
      Select(cost.shift > 0.f, Min(Abs(plane.rho - prior.rho) * cost.shift / tolerated, Splat(1)),
             Splat(1));
  // What is known already weighs as much as the samples of the patch say less: the slope of the
  // cost by the likelihood (1 - NCC^2)^(-n / 2).
  const Floats mean = Min(photometric * scale, Splat(0.95f));
  const Floats count = kIndependentSamples * Max(Floats(views_count), Splat(1));
  const Floats per_likelihood = mean * (2.f - mean) / (count * (1.f - mean));
  const Floats deviations = (plane.rho - prior.rho) / Max(prior.deviation, Splat(1e-20f));
  const Floats known_value = Select(
      prior.rho > 0.f,
      options.prior_weight * per_likelihood * Min(0.5f * deviations * deviations, Splat(4.5f)),
      Floats{});
  cost.value = Select(possible, value + prior.trust * deviation + known_value, Splat(kRejected));
  cost.photometric = Select(compared & possible, photometric / Select(compared, weights, Splat(1)),
                            Splat(kWorstCost));
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
  best_cost->photometric = Select(better, cost.photometric, best_cost->photometric);
}

SIRPY_INLINE void Store(const Level& level, const Group& group, const Plane& plane, Floats cost,
                        Words views, Planes* planes) {
  for (int lane = 0; lane < group.count; ++lane) {
    const int64_t at = int64_t(group.y) * level.width + group.column[lane];
    planes->rho[at] = plane.rho[lane];
    planes->gx[at] = plane.gx[lane];
    planes->gy[at] = plane.gy[lane];
    planes->cost[at] = cost[lane];
    planes->views[at] = views[lane];
  }
}

SIRPY_INLINE Words StoredViews(const Level& level, const Planes& planes, const Group& group) {
  Words views;
  for (int lane = 0; lane < kLanes; ++lane) {
    views[lane] = planes.views[int64_t(group.y) * level.width + group.column[lane]];
  }
  return views;
}

// Where a lane has no source: those that suit its present plane best.
SIRPY_INLINE void ChooseWhereNone(const Level& level, const Group& group,
                                  const KernelOptions& options, int count, const Plane& plane,
                                  ViewWeights* views) {
  const Ints none = views->used == 0u;
  if (!Any(none)) return;
  Floats costs[kMaxSources];
  SourceCosts(level, group, plane, costs);
  const int most = count < options.top_views ? count : options.top_views;
  Replace(none, BestViews(UnionOf(group.allowed), most, costs), views);
}

// Random numbers of the group's pixels for one draw.
SIRPY_INLINE Floats Draw(const Level& level, const Group& group, int iteration, int draw) {
  Floats value;
  const uint64_t what = uint64_t(iteration) << 16 | uint64_t(draw);
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

// Candidates of the initialisation: for each pixel of the row the best of `count` planes. A plane
// without sources is judged by those that it looks best in.
void EvaluateRow(const Level& level, const KernelOptions& options, const Planes* candidates,
                 int count, Planes* planes, int y) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      const Prior prior = LoadPrior(level, options, group);
      Plane best = LoadPlanes(level, *planes, group);
      Words best_views{};
      Cost best_cost{Splat(4 * kWorstCost), Floats{}, Floats{}};
      for (int i = 0; i < count; ++i) {
        Plane plane;
        Words sources;
        for (int lane = 0; lane < kLanes; ++lane) {
          const int column = group.column[lane];
          plane.rho[lane] = candidates[i].rho[column];
          plane.gx[lane] = candidates[i].gx[column];
          plane.gy[lane] = candidates[i].gy[column];
          sources[lane] = candidates[i].views[column];
        }
        ViewWeights views = EqualWeights(sources & group.allowed);
        ChooseWhereNone(level, group, options, 3, plane, &views);
        const Cost cost = PlaneCost(level, options, group, prior, views, plane, best_cost.value);
        const Ints better = (cost.value < kRejected) & (cost.value < best_cost.value);
        Keep(better, plane, cost, &best, &best_cost);
        best_views = (views.used & (Words)better) | (best_views & ~(Words)better);
      }
      Store(level, group, best, best_cost.value, best_views, planes);
    }
  }
}

// Steps are sizes in source pixels, so they suit any focal length, baseline and height.
SIRPY_INLINE void Refine(const Level& level, const KernelOptions& options, const Planes& planes,
                         const Group& group, const Prior& prior, const ViewWeights& views,
                         int iteration, Plane* best, Cost* best_cost) {
  const float largest = level.largest_step / float(1 << (iteration < 4 ? iteration : 4));
  const auto attempt = [&](const Plane& plane) {
    const Cost cost = PlaneCost(level, options, group, prior, views, plane, best_cost->value);
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
  if (level.everywhere && iteration < 2) {
    Plane anywhere = *best;
    anywhere.rho = group.min_rho + draw(6) * (group.max_rho - group.min_rho);
    attempt(anywhere);
  }
}

// Half a sweep over one row: propagate, select views, refine.
void SweepRow(const Level& level, const KernelOptions& options, Planes* planes, int y, int colour,
              int iteration) {
  const int first_of_row = (colour + level.x0 + level.y0 + y) & 1;
  for (int first = first_of_row; first < level.width; first += 2 * kLanes) {
    const Group group = LoadGroup(level, options, first, y);
    const Prior prior = LoadPrior(level, options, group);
    Offers offers = CollectOffers(level, *planes, group, level.offers);
    for (int i = 0; i < offers.count; ++i) {
      offers.valid[i] &= IsPossible(level, group, offers.plane[i]);
    }
    Plane best = LoadPlanes(level, *planes, group);
    Floats costs[8][kMaxSources];
    for (int i = 0; i < offers.count; ++i) {
      SourceCosts(level, group, offers.plane[i], costs[i]);
    }
    ViewWeights views =
        SelectViews(level, options, *planes, group, costs, offers.valid, offers.count, iteration);
    ChooseWhereNone(level, group, options, 2, best, &views);
    Cost best_cost = PlaneCost(level, options, group, prior, views, best, Splat(kUnbounded));
    for (int i = 0; i < offers.count; ++i) {
      const Plane& plane = offers.plane[i];
      const Cost cost =
          PlaneCost(level, options, group, prior, views, plane, best_cost.value, costs[i]);
      Keep(offers.valid[i] & (cost.value < best_cost.value), plane, cost, &best, &best_cost);
    }
    Refine(level, options, *planes, group, prior, views, iteration, &best, &best_cost);
    Store(level, group, best, best_cost.value, views.used, planes);
  }
}

// Standard deviation, in pixels of motion, of a depth whose costs are c here and half a pixel
// nearer and farther: by the curvature of the likelihood (1 - NCC^2)^(-n / 2) of n independent
// samples.
SIRPY_INLINE Floats MatchingDeviation(Floats nearer, Floats cost, Floats farther, Floats samples) {
  const Floats curvature = Max((nearer - 2.f * cost + farther) * 4.f, Splat(1e-4f));
  const Floats c = Min(Max(cost, Splat(0.002f)), Splat(0.95f));
  const Floats variance = c * (2.f - c) / (samples * (1.f - c) * curvature);
  return Min(Sqrt(variance) + kLeastDeviation, Splat(kLargestDeviation));
}

struct Final {
  Cost cost;
  Floats deviation;  // pixels of motion
};

// Sub-pixel depth: the vertex of the parabola through the costs half a pixel nearer and farther.
SIRPY_INLINE Final RefineDepth(const Level& level, const KernelOptions& options, const Group& group,
                               const Prior& prior, const ViewWeights& views, Plane* best) {
  const auto cost_of = [&](const Plane& plane) {
    return PlaneCost(level, options, group, prior, views, plane, Splat(kUnbounded));
  };
  Cost cost = cost_of(*best);
  if (options.carry) return {cost, Floats{}};
  const Floats step = 0.5f / Max(cost.shift, Splat(1e-20f));
  const auto moved = [&](Floats steps) {
    Plane plane = *best;
    plane.rho += steps * step;
    return plane;
  };
  const Cost near = cost_of(moved(Splat(1))), far = cost_of(moved(Splat(-1)));
  Floats count{};
  for (Sources j{views.any}; j.more(); j.next()) count += views.weight[*j];
  const Floats deviation = MatchingDeviation(near.photometric, cost.photometric, far.photometric,
                                             kIndependentSamples * Max(count, Splat(1)));
  if (!options.refine) return {cost, deviation};
  const Floats nearer = near.value, farther = far.value;
  const Floats curvature = nearer - 2.f * cost.value + farther;
  const Ints convex = curvature > 1e-6f;
  const Floats offset = 0.5f * (farther - nearer) / Select(convex, curvature, Splat(1));
  const Plane vertex = moved(Min(Max(offset, Splat(-1)), Splat(1)));
  const Cost vertex_cost = cost_of(vertex);
  Keep(convex & (vertex_cost.value < cost.value), vertex, vertex_cost, best, &cost);
  return {cost, deviation};
}

// What is known of the final planes of a row, after a last refinement where one is asked for.
void FinishRow(const Level& level, const KernelOptions& options, Planes* planes,
               Assessment* assessment, int y) {
  for (int colour = 0; colour < 2; ++colour) {
    for (int first = colour; first < level.width; first += 2 * kLanes) {
      const Group group = LoadGroup(level, options, first, y);
      const Words used = StoredViews(level, *planes, group);
      Plane plane = LoadPlanes(level, *planes, group);
      const Prior prior = LoadPrior(level, options, group);
      const auto [cost, matching_deviation] =
          RefineDepth(level, options, group, prior, EqualWeights(used), &plane);
      Store(level, group, plane, cost.value, used, planes);
      const Ints possible = IsPossible(level, group, plane);
      // What the level's pixels say counts where it is more than is known already.
      Floats deviation = matching_deviation / Max(cost.shift, Splat(1e-20f));
      const Ints held = options.carry
                            ? prior.rho > 0.f
                            : (prior.rho > 0.f) &
                                  (Abs(plane.rho - prior.rho) <= 3.f * prior.deviation) &
                                  ((deviation >= prior.deviation) | (prior.trust > kHeldTrust));
      deviation = Select(held, prior.deviation, deviation);
      // Of a plane that nobody has searched for, the curvature says nothing: wrong ones would agree
      // with all sources.
      const Ints is_known = held | ((cost.shift > 0.f) & SplatInt(options.refine ? -1 : 0));
      Floats seeing{}, consistent{};
      for (Sources j{UnionOf(group.allowed)}; j.more(); j.next()) {
        const Ints allowed = possible & Has(group.allowed, *j);
        const Warp warp = WarpPatch(level, group, *j, plane);
        seeing += Select(allowed & warp.inside, Splat(1), Floats{});
        if (level.sources[*j].inverse_depth) {
          const auto [error, spread] = ForwardBackward(level, group, *j, warp);
          const Floats own = Select(is_known, deviation * warp.shift, Floats{});
          const Floats tolerated = Max(options.agreement * Sqrt(own * own + spread * spread),
                                       Splat(options.consistency));
          const Ints agrees = allowed & (error >= 0.f) & (error < tolerated);
          consistent += Select(agrees, Splat(1), Floats{});
        }
      }
      const Floats texture = group.spread / group.weight_sum;
      for (int lane = 0; lane < group.count; ++lane) {
        const int64_t at = int64_t(y) * level.width + group.column[lane];
        assessment->cost[at] = cost.photometric[lane];
        assessment->texture[at] = texture[lane];
        assessment->num_seeing[at] = uint8_t(seeing[lane]);
        assessment->num_consistent[at] = uint8_t(consistent[lane]);
        assessment->deviation[at] = deviation[lane];
        assessment->shift[at] = cost.shift[lane];
        assessment->held[at] = held[lane] != 0;
      }
    }
  }
}

#define SIRPY_STRING_(x) #x
#define SIRPY_STRING(x) SIRPY_STRING_(x)
extern const Kernels kKernels;
const Kernels kKernels = {SIRPY_STRING(SIRPY_ISA), EvaluateRow, SweepRow, FinishRow};

}  // namespace sirpy::patch_match::SIRPY_ISA
