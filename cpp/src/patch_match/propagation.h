// Where planes come from: adaptive checkerboard sampling (Xu and Tao, ACMH, CVPR 2019, section
// 3.1). In each of eight regions (a V of 7 pixels next to the pixel and a strip of 11 farther out,
// in four directions) the pixel of the lowest cost offers its plane. All of them have the other
// colour, so a half sweep uses only what it does not write (lanes between them are loaded and
// thrown away).
#pragma once

#include "patch_match/patch.h"

namespace sirpy::patch_match::SIRPY_ISA {

// (along, across) steps of the two kinds of region; "along" points away from the pixel.
constexpr int kNear[7][2] = {{1, 0}, {2, -1}, {2, 1}, {3, -2}, {3, 2}, {4, -3}, {4, 3}};
constexpr int kFar[11][2] = {{3, 0},  {5, 0},  {7, 0},  {9, 0},  {11, 0}, {13, 0},
                             {15, 0}, {17, 0}, {19, 0}, {21, 0}, {23, 0}};
static_assert(kFar[10][0] == kSweepReach);

SIRPY_INLINE Plane LoadPlanes(const Level& level, const Planes& planes, const Group& group) {
  Plane plane;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int64_t at = int64_t(group.y) * level.width + group.column[lane];
    plane.rho[lane] = planes.rho[at];
    plane.gx[lane] = planes.gx[at];
    plane.gy[lane] = planes.gy[at];
  }
  return plane;
}

// The planes that the regions offer to each lane, carried over to the lane's pixel, those of the
// lowest cost first; `valid` is false where a region lies outside the window.
struct Offers {
  int count;
  Plane plane[8];
  Ints valid[8];
};

SIRPY_FUNCTION Offers CollectOffers(const Level& level, const Planes& planes, const Group& group,
                                    int count) {
  static constexpr int kAlong[4][2] = {{0, -1}, {0, 1}, {-1, 0}, {1, 0}};
  constexpr float kNone = 3 * kWorstCost;
  const int first = group.column[0];
  const bool inner = first >= kSweepReach && first + 2 * kLanes + kSweepReach <= level.width;
  const auto costs_at = [&](int dx, int y) {
    const float* row = planes.cost + int64_t(y) * level.width;
    if (inner) return EverySecond(row + first + dx);
    Floats costs;
    for (int lane = 0; lane < kLanes; ++lane) {
      const int x = group.column[lane] + dx;
      costs[lane] = x < 0 || x >= level.width ? kNone : row[x];
    }
    return costs;
  };

  Floats cost[8];
  Ints step[8];  // to the best pixel of the region: dy in the high half, dx in the low one
  for (int region = 0; region < 8; ++region) {
    const int along_x = kAlong[region % 4][0], along_y = kAlong[region % 4][1];
    const bool near = region < 4;
    cost[region] = Splat(kNone);
    step[region] = Ints{};
    for (int i = 0; i < (near ? 7 : 11); ++i) {
      const int* along = near ? kNear[i] : kFar[i];
      const int dx = along_x * along[0] + along_y * along[1];
      const int dy = along_y * along[0] + along_x * along[1];
      const int y = group.y + dy;
      if (y < 0 || y >= level.height) continue;
      const Floats found = costs_at(dx, y);
      const Ints better = found < cost[region];
      cost[region] = Select(better, found, cost[region]);
      step[region] = Select(better, SplatInt(dy * 65536 + (dx & 0xffff)), step[region]);
    }
  }

  Offers offers{};
  offers.count = count;
  Ints here;
  for (int lane = 0; lane < kLanes; ++lane) {
    here[lane] = group.y * level.width + group.column[lane];
  }
  for (int i = 0; i < count; ++i) {
    // The best of those left moves to the front; equal ones keep their order.
    for (int k = 7; k > i; --k) {
      const Ints swap = cost[k] < cost[k - 1];
      const Floats low = Select(swap, cost[k], cost[k - 1]);
      const Ints low_step = Select(swap, step[k], step[k - 1]);
      cost[k] = Select(swap, cost[k - 1], cost[k]);
      step[k] = Select(swap, step[k - 1], step[k]);
      cost[k - 1] = low;
      step[k - 1] = low_step;
    }
    const Ints dx = step[i] << 16 >> 16, dy = step[i] >> 16;
    const Ints at = here + dy * level.width + dx;
    Plane& plane = offers.plane[i];
    plane.gx = Gather(planes.gx, at);
    plane.gy = Gather(planes.gy, at);
    plane.rho = Gather(planes.rho, at) - plane.gx * ToFloats(dx) - plane.gy * ToFloats(dy);
    offers.valid[i] = cost[i] < kNone;
  }
  return offers;
}

// The gradient that the four direct neighbours suggest: central differences, one-sided at the
// border.
SIRPY_INLINE Plane WithNeighbourSlope(const Level& level, const Planes& planes, const Group& group,
                                      const Plane& plane) {
  Plane sloped = plane;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int x = group.column[lane], y = group.y;
    const int left = x > 0, right = x + 1 < level.width, up = y > 0, down = y + 1 < level.height;
    const float* rho = planes.rho + int64_t(y) * level.width + x;
    const float here = plane.rho[lane];
    const auto at = [&](int exists, int64_t step) { return exists ? rho[step] : here; };
    if (left + right) sloped.gx[lane] = (at(right, 1) - at(left, -1)) / float(left + right);
    if (up + down) {
      sloped.gy[lane] = (at(down, level.width) - at(up, -level.width)) / float(up + down);
    }
  }
  return sloped;
}

}  // namespace sirpy::patch_match::SIRPY_ISA
