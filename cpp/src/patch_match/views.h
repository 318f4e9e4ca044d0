// Which sources a pixel is matched against: joint view selection after Xu and Tao, "Multi-scale
// geometric consistency guided multi-view stereo" (ACMM), CVPR 2019, section 3.2: a source is as
// good as the planes of the neighbours look in it, and as the neighbours think of it. The best few
// by weight are taken instead of a random draw: fewer costs to compute, and nothing depends on
// chance.
#pragma once

#include "patch_match/ncc.h"

namespace sirpy::patch_match::SIRPY_ISA {

struct ViewWeights {
  Floats weight[kMaxSources];
  Ints used[kMaxSources];
  bool any[kMaxSources];
};

// Keeps the `count` largest of the weights of each lane; equal ones in the order of the sources.
SIRPY_INLINE void KeepLargest(int num_sources, int count, ViewWeights* views) {
  Ints rank[kMaxSources] = {};
  for (int j = 0; j < num_sources; ++j) {
    for (int k = 0; k < j; ++k) {
      const Ints later = views->weight[k] >= views->weight[j];
      rank[j] -= later;
      rank[k] -= ~later;
    }
  }
  for (int j = 0; j < num_sources; ++j) {
    views->used[j] = (rank[j] < count) & (views->weight[j] > 0.f);
    views->weight[j] = Select(views->used[j], views->weight[j], Floats{});
    views->any[j] = Any(views->used[j]);
  }
}

// costs[i][j]: of the plane of neighbour i in source j; valid[i]: the neighbour exists.
SIRPY_INLINE ViewWeights SelectViews(const Level& level, const KernelOptions& options,
                                     const Planes& planes, const Group& group,
                                     const Floats costs[8][kMaxSources], const Ints valid[8],
                                     int num_neighbours, int iteration) {
  const float good = 0.8f * __builtin_expf(-float(iteration * iteration) / 90.f);
  const float middling = __builtin_expf(-good * good / (2 * 0.4f * 0.4f));
  ViewWeights views;
  for (int j = 0; j < level.num_sources; ++j) {
    Floats num_good{}, num_bad{}, sum{};
    for (int i = 0; i < num_neighbours; ++i) {
      const Floats cost = costs[i][j];
      const Ints is_good = valid[i] & (cost < good);
      num_good += Select(is_good, Splat(1), Floats{});
      num_bad += Select(valid[i] & (cost > 1.2f), Splat(1), Floats{});
      sum += Select(is_good, Exp(cost * cost * (-1.f / (2 * 0.3f * 0.3f))), Floats{});
    }
    const Floats score = Select(num_good > 2.f, sum / Max(num_good, Splat(1)), Splat(middling));
    Floats prior{};
    const int64_t row = int64_t(group.y) * level.width;
    for (int lane = 0; lane < kLanes; ++lane) {
      const int x = group.column[lane];
      const int64_t at = row + x;
      const auto chosen = [&](bool exists, int64_t neighbour) {
        return exists && (planes.views[neighbour] >> j & 1) ? 0.9f : 0.1f;
      };
      prior[lane] = chosen(x > 0, at - 1) + chosen(x + 1 < level.width, at + 1) +
                    chosen(group.y > 0, at - level.width) +
                    chosen(group.y + 1 < level.height, at + level.width);
    }
    views.weight[j] = Select(num_bad < 3.f, score * prior, Floats{});
  }
  KeepLargest(level.num_sources, options.top_views, &views);
  return views;
}

// The `count` sources in which a plane looks best, with equal weights: for planes that no neighbour
// vouches for.
SIRPY_INLINE ViewWeights BestViews(int num_sources, int count, const Floats costs[kMaxSources]) {
  ViewWeights views;
  for (int j = 0; j < num_sources; ++j) views.weight[j] = kWorstCost - costs[j];
  KeepLargest(num_sources, count, &views);
  for (int j = 0; j < num_sources; ++j) {
    views.weight[j] = Select(views.used[j], Splat(1), Floats{});
  }
  return views;
}

// The lanes that no source was chosen for.
SIRPY_INLINE Ints NoView(int num_sources, const ViewWeights& views) {
  Ints none = SplatInt(-1);
  for (int j = 0; j < num_sources; ++j) none &= ~views.used[j];
  return none;
}

SIRPY_INLINE void Replace(int num_sources, Ints lanes, const ViewWeights& by, ViewWeights* views) {
  for (int j = 0; j < num_sources; ++j) {
    views->used[j] = (lanes & by.used[j]) | (~lanes & views->used[j]);
    views->weight[j] = Select(lanes, by.weight[j], views->weight[j]);
    views->any[j] = Any(views->used[j]);
  }
}

}  // namespace sirpy::patch_match::SIRPY_ISA
