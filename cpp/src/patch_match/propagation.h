// Where planes come from: adaptive checkerboard sampling (Xu and Tao, ACMH, CVPR 2019, section 3.1). In each of
// eight regions (a V of 7 pixels next to the pixel and a strip of 11 farther out, in four directions) the pixel
// of the lowest cost offers its plane. All of them have the other colour, so a half sweep reads only what it
// does not write.
#pragma once

#include "patch_match/patch.h"

namespace sirpy::patch_match::SIRPY_ISA {

// (along, across) steps of the two kinds of region; "along" points away from the pixel.
constexpr int kNear[7][2] = {{1, 0}, {2, -1}, {2, 1}, {3, -2}, {3, 2}, {4, -3}, {4, 3}};
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

// The plane that region `region` (0-3 near, 4-7 far; up, down, left, right) offers to each lane, carried over
// to the lane's pixel; valid is false where the region lies outside the window.
SIRPY_INLINE Plane OfferedPlane(const Level& level, const Planes& planes, const Group& group,
                                int region, Ints* valid) {
  static constexpr int kAlong[4][2] = {{0, -1}, {0, 1}, {-1, 0}, {1, 0}};
  const int along_x = kAlong[region % 4][0], along_y = kAlong[region % 4][1];
  const bool near = region < 4;
  Plane plane{};
  for (int lane = 0; lane < kLanes; ++lane) {
    float lowest = 3 * kWorstCost;
    int best_dx = 0, best_dy = 0;
    int64_t best = -1;
    for (int i = 0; i < (near ? 7 : 11); ++i) {
      const int* step = near ? kNear[i] : kFar[i];
      const int dx = along_x * step[0] + along_y * step[1];
      const int dy = along_y * step[0] + along_x * step[1];
      const int x = group.column[lane] + dx, y = group.y + dy;
      if (x < 0 || y < 0 || x >= level.width || y >= level.height) continue;
      const int64_t at = int64_t(y) * level.width + x;
      if (planes.cost[at] < lowest) {
        lowest = planes.cost[at];
        best = at;
        best_dx = dx;
        best_dy = dy;
      }
    }
    (*valid)[lane] = best >= 0 ? -1 : 0;
    if (best < 0) continue;
    plane.gx[lane] = planes.gx[best];
    plane.gy[lane] = planes.gy[best];
    plane.rho[lane] =
        planes.rho[best] - planes.gx[best] * float(best_dx) - planes.gy[best] * float(best_dy);
  }
  return plane;
}

// The gradient that the four direct neighbours suggest: central differences, one-sided at the border.
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
