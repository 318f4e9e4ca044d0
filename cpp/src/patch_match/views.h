// Which sources a pixel is matched against: joint view selection after Xu and Tao, "Multi-scale
// geometric consistency guided multi-view stereo" (ACMM), CVPR 2019, section 3.2: a source is as
// good as the planes of the neighbours look in it, and as the neighbours think of it. The best few
// by weight are taken instead of a random draw: fewer costs to compute, and nothing depends on
// chance.
//
// A set of sources is a word, bit j for source j. Lanes have sets of their own; work is done for
// every source of their union, and what a lane did not ask for is masked out, so that no lane's
// result depends on its company.
#pragma once

#include "patch_match/geometric.h"

namespace sirpy::patch_match::SIRPY_ISA {

SIRPY_INLINE Ints Has(Words sets, int j) { return ((sets >> j) & 1u) != 0u; }

SIRPY_INLINE uint32_t UnionOf(Words sets) {
  uint32_t all = 0;
  for (int lane = 0; lane < kLanes; ++lane) all |= sets[lane];
  return all;
}

// The sources of a set, from the first to the last: for (Sources j(set); j.more(); j.next()).
struct Sources {
  uint32_t left;
  bool more() const { return left != 0; }
  void next() { left &= left - 1; }
  int operator*() const { return __builtin_ctz(left); }
};

// Weights are defined for the sources of `any` alone, and 0 in the lanes that do not use them.
struct ViewWeights {
  uint32_t any = 0;
  Words used{};
  Floats weight[kMaxSources];
};

// Keeps the `count` largest of the weights of each lane; equal ones in the order of the sources.
SIRPY_INLINE void KeepLargest(int count, ViewWeights* views) {
  Ints rank[kMaxSources];
  for (Sources j{views->any}; j.more(); j.next()) rank[*j] = Ints{};
  views->used = Words{};
  for (Sources j{views->any}; j.more(); j.next()) {
    for (Sources k{views->any & ((1u << *j) - 1u)}; k.more(); k.next()) {
      const Ints later = views->weight[*k] >= views->weight[*j];
      rank[*j] -= later;
      rank[*k] -= ~later;
    }
  }
  uint32_t any = 0;
  for (Sources j{views->any}; j.more(); j.next()) {
    const Ints used = (rank[*j] < count) & (views->weight[*j] > 0.f);
    views->weight[*j] = Select(used, views->weight[*j], Floats{});
    views->used |= ((Words)used & 1u) << *j;
    if (Any(used)) any |= 1u << *j;
  }
  views->any = any;
}

// Equal weights for the sources of a set.
SIRPY_INLINE ViewWeights EqualWeights(Words sets) {
  ViewWeights views;
  views.any = UnionOf(sets);
  views.used = sets;
  for (Sources j{views.any}; j.more(); j.next()) {
    views.weight[*j] = Select(Has(sets, *j), Splat(1), Floats{});
  }
  return views;
}

// The `count` sources in which a plane looks best, with equal weights: for planes that no neighbour
// vouches for.
SIRPY_INLINE ViewWeights BestViews(uint32_t sources, int count, const Floats costs[kMaxSources]) {
  ViewWeights views;
  views.any = sources;
  for (Sources j{sources}; j.more(); j.next()) views.weight[*j] = kWorstCost - costs[*j];
  KeepLargest(count, &views);
  return EqualWeights(views.used);
}

// Takes the views `by` in the lanes of the mask.
SIRPY_INLINE void Replace(Ints lanes, const ViewWeights& by, ViewWeights* views) {
  const uint32_t taken = UnionOf(by.used & (Words)lanes);
  for (Sources j{views->any | taken}; j.more(); j.next()) {
    const Floats new_weight = (taken >> *j & 1) ? by.weight[*j] : Floats{};
    const Floats old_weight = (views->any >> *j & 1) ? views->weight[*j] : Floats{};
    views->weight[*j] = Select(lanes, new_weight, old_weight);
  }
  views->any |= taken;
  views->used = (by.used & (Words)lanes) | (views->used & ~(Words)lanes);
}

// costs[i][j]: of the plane of neighbour i in source j, of those that are allowed; valid[i]: the
// neighbour exists.
SIRPY_INLINE ViewWeights SelectViews(const Level& level, const KernelOptions& options,
                                     const Planes& planes, const Group& group,
                                     const Floats costs[8][kMaxSources], const Ints valid[8],
                                     int num_neighbours, int iteration) {
  const float good = 0.8f * __builtin_expf(-float(iteration * iteration) / 90.f);
  const float middling = __builtin_expf(-good * good / (2 * 0.4f * 0.4f));
  const auto views_at = [&](int dx, int dy) {
    Words used{};
    for (int lane = 0; lane < kLanes; ++lane) {
      const int x = group.column[lane] + dx, y = group.y + dy;
      const bool exists = x >= 0 && x < level.width && y >= 0 && y < level.height;
      used[lane] = exists ? planes.views[int64_t(y) * level.width + x] : 0;
    }
    return used;
  };
  const Words neighbours[4] = {views_at(-1, 0), views_at(1, 0), views_at(0, -1), views_at(0, 1)};
  ViewWeights views;
  views.any = UnionOf(group.allowed);
  for (Sources j{views.any}; j.more(); j.next()) {
    Floats num_good{}, num_bad{}, sum{};
    for (int i = 0; i < num_neighbours; ++i) {
      const Floats cost = costs[i][*j];
      const Ints is_good = valid[i] & (cost < good);
      num_good += Select(is_good, Splat(1), Floats{});
      num_bad += Select(valid[i] & (cost > 1.2f), Splat(1), Floats{});
      sum += Select(is_good, Exp(cost * cost * (-1.f / (2 * 0.3f * 0.3f))), Floats{});
    }
    const Floats score = Select(num_good > 2.f, sum / Max(num_good, Splat(1)), Splat(middling));
    Floats prior{};
    for (const Words& neighbour : neighbours) {
      prior += Select(Has(neighbour, *j), Splat(0.9f), Splat(0.1f));
    }
    views.weight[*j] = Select(Has(group.allowed, *j) & (num_bad < 3.f), score * prior, Floats{});
  }
  KeepLargest(options.top_views, &views);
  return views;
}

}  // namespace sirpy::patch_match::SIRPY_ISA
