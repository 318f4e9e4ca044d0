// Where planes come from: adaptive checkerboard sampling (Xu and Tao, ACMH, CVPR 2019, section
// 3.1). In each of eight regions (a V of 7 pixels next to the pixel and a strip of 11 farther out,
// in four directions) the pixel of the lowest cost offers its plane. All of them have the other
// colour, so a half sweep reads only what it does not write.
#pragma once

#include "patch_match/patch.h"

namespace sirpy::patch_match::SIRPY_ISA {

// (along, across) steps of the two kinds of region; "along" points away from the pixel.
constexpr int kNear[7][2] = {{1, 0}, {2, -1}, {2, 1}, {3, -2}, {3, 2}, {4, -3}, {4, 3}};
static_assert(kSweepReach == 23);
constexpr int kFar[11][2] = {{3, 0},  {5, 0},  {7, 0},  {9, 0},  {11, 0}, {13, 0},
                             {15, 0}, {17, 0}, {19, 0}, {21, 0}, {23, 0}};

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
  Words views;  // that the pixels they come from are matched against
};

SIRPY_FUNCTION Offers CollectOffers(const Level& level, const Planes& planes, const Group& group,
                                    int count) {
  static constexpr int kAlong[4][2] = {{0, -1}, {0, 1}, {-1, 0}, {1, 0}};
  struct Offer {
    float cost;
    int dx, dy;
  };
  Offers offers{};
  offers.count = count;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int column = group.column[lane];
    const float* costs = planes.cost + int64_t(group.y) * level.width + column;
    Offer sorted[8];
    int found = 0;
    for (int region = 0; region < 8; ++region) {
      const int along_x = kAlong[region % 4][0], along_y = kAlong[region % 4][1];
      const bool near = region < 4;
      Offer best{3 * kWorstCost, 0, 0};
      for (int i = 0; i < (near ? 7 : 11); ++i) {
        const int* step = near ? kNear[i] : kFar[i];
        const int dx = along_x * step[0] + along_y * step[1];
        const int dy = along_y * step[0] + along_x * step[1];
        const int x = column + dx, y = group.y + dy;
        if (x < 0 || y < 0 || x >= level.width || y >= level.height) continue;
        const float cost = costs[int64_t(dy) * level.width + dx];
        if (cost < best.cost) best = {cost, dx, dy};
      }
      if (best.dx == 0 && best.dy == 0) continue;
      int at = found++;
      for (; at > 0 && best.cost < sorted[at - 1].cost; --at) sorted[at] = sorted[at - 1];
      sorted[at] = best;
    }
    for (int i = 0; i < found && i < count; ++i) {
      const Offer& offer = sorted[i];
      const int64_t at = int64_t(group.y + offer.dy) * level.width + column + offer.dx;
      Plane& plane = offers.plane[i];
      plane.gx[lane] = planes.gx[at];
      plane.gy[lane] = planes.gy[at];
      plane.rho[lane] =
          planes.rho[at] - planes.gx[at] * float(offer.dx) - planes.gy[at] * float(offer.dy);
      offers.valid[i][lane] = -1;
      offers.views[lane] |= planes.views[at];
    }
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
