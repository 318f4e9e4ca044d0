// The plan of a synthetic town: a grid of streets with blocks between them, cut into lots. Plan
// coordinates are metres along and across the streets; plan_from_world turns by `angle` about the
// world's origin.
#pragma once

#include <cmath>
#include <cstdint>

#include <Eigen/Core>

#include "synthetic/noise.h"

namespace sirpy {

enum class BlockUse { kHouses, kHalls, kPark };

struct TownPlan {
  uint64_t seed = 1;
  double angle = 0.3;             // of the streets, radians
  Eigen::Vector2d block{50, 40};  // from one street's axis to the next, m
  double road_width = 6;
  double pavement_width = 1.6;
  int lots_x = 3;  // of a block
  int lots_y = 2;

  Eigen::Vector2d PlanFromWorld(const Eigen::Vector2d& world) const {
    const double c = std::cos(angle), s = std::sin(angle);
    return {c * world.x() + s * world.y(), -s * world.x() + c * world.y()};
  }
  Eigen::Vector2d WorldFromPlan(const Eigen::Vector2d& plan) const {
    const double c = std::cos(angle), s = std::sin(angle);
    return {c * plan.x() - s * plan.y(), s * plan.x() + c * plan.y()};
  }

  // From a street's axis to where the lots begin.
  double Setback() const { return road_width / 2 + pavement_width; }
  Eigen::Vector2d LotSize() const {
    return (block.array() - 2 * Setback()) / Eigen::Array2d(lots_x, lots_y);
  }

  // Every neighbourhood gets some of each use.
  BlockUse Use(int64_t column, int64_t row) const {
    const uint64_t place = static_cast<uint64_t>(column + 3 * row) + seed;
    if (place % 5 == 1 || place % 5 == 3)
      return place % 5 == 1 ? BlockUse::kHalls : BlockUse::kPark;
    return BlockUse::kHouses;
  }
};

// A smooth fractal height field: metres above zero at a world place (x, y).
inline double TerrainHeight(uint64_t seed, double x, double y) {
  return 4.0 * Noise(Hash(seed, 101), x / 130, y / 130) +
         1.6 * Noise(Hash(seed, 102), x / 55, y / 55) +
         0.4 * Noise(Hash(seed, 103), x / 21, y / 21);
}

}  // namespace sirpy
