#include "synthetic/texture.h"

#include <algorithm>
#include <cmath>

namespace sirpy {
namespace {

using Colour = Eigen::Vector3f;

const Colour kAsphalt(0.095f, 0.095f, 0.1f);
const Colour kLine(0.6f, 0.6f, 0.57f);
const Colour kConcrete(0.3f, 0.28f, 0.26f);
const Colour kLawn(0.075f, 0.13f, 0.035f);
const Colour kDryGrass(0.2f, 0.18f, 0.08f);
const Colour kSoil(0.17f, 0.115f, 0.07f);
const Colour kCrop(0.05f, 0.11f, 0.03f);
const Colour kGlass(0.035f, 0.045f, 0.055f);

Colour Mix(const Colour& a, const Colour& b, double share) {
  return a + static_cast<float>(std::clamp(share, 0.0, 1.0)) * (b - a);
}

// 1 where detail of `size` is resolved, 0 where it would alias.
double Resolved(double size, double footprint) {
  return std::clamp(2 * size / footprint - 1, 0.0, 1.0);
}

// Octaves of noise from the finest size upwards, each `persistence` times the one below it.
double Fractal(uint64_t seed, double x, double y, const TextureScale& scale, int octaves,
               double persistence) {
  double sum = 0, amplitude = 1, size = scale.finest;
  for (int octave = 0; octave < octaves; ++octave) {
    const double weight = amplitude * Resolved(size, scale.footprint);
    if (weight > 0) sum += weight * Noise(seed + octave, x / size, y / size);
    amplitude *= persistence;
    size *= 2;
  }
  return sum;
}

double Positive(double x, double period) {
  return x - period * static_cast<double>(Floor(x / period));
}

Colour Textured(const Colour& colour, double contrast, double value) {
  return colour * static_cast<float>(std::max(0.1, 1 + contrast * value));
}

Colour Road(const TownPlan& plan, double across, double along, double to_crossing,
            const Eigen::Vector2d& p, const TextureScale& scale) {
  const uint64_t seed = Hash(plan.seed, 11);
  const bool dash = std::abs(across) < 0.1 && Positive(along, 5) < 2.4 && to_crossing > 5;
  const double wear = Noise(seed, p.x() / 3.7, p.y() / 3.7);
  const Colour base = Mix(kAsphalt, 1.5f * kAsphalt, 0.5 + 0.5 * wear);
  const Colour colour = dash ? Mix(kLine, base, 0.3 + 0.3 * wear) : base;
  return Textured(colour, 0.2, Fractal(Hash(seed, 1), p.x(), p.y(), scale, 4, 0.9));
}

Colour Pavement(const TownPlan& plan, const Eigen::Vector2d& p, const TextureScale& scale) {
  constexpr double kSlab = 0.8;
  const uint64_t seed = Hash(plan.seed, 12);
  const int64_t column = Floor(p.x() / kSlab);
  const int64_t row = Floor(p.y() / kSlab);
  const double slab = 0.35 * (Uniform(Hash(seed, column, row)) - 0.5);
  return Textured(kConcrete, 1, slab + 0.15 * Fractal(Hash(seed, 1), p.x(), p.y(), scale, 4, 0.9));
}

Colour Grass(uint64_t seed, const Eigen::Vector2d& p, double dryness, const TextureScale& scale) {
  const double patch = 0.6 * Noise(Hash(seed, 1), p.x() / 5.3, p.y() / 5.3) +
                       0.5 * Noise(Hash(seed, 2), p.x() / 1.4, p.y() / 1.4);
  const Colour base = Mix(kLawn, kDryGrass, dryness + 0.45 * patch);
  return Textured(base, 0.32, Fractal(Hash(seed, 3), p.x(), p.y(), scale, 5, 0.85));
}

Colour Field(uint64_t seed, const Eigen::Vector2d& p, const TextureScale& scale) {
  const double row = Positive(p.x() + 0.25 * Noise(Hash(seed, 1), p.x() / 9, p.y() / 9), 1.1);
  const double plants =
      1 - std::abs(row - 0.55) / 0.4 + 0.5 * Fractal(Hash(seed, 2), p.x(), p.y(), scale, 4, 1.0);
  return Textured(Mix(kSoil, kCrop, plants), 0.25,
                  Fractal(Hash(seed, 3), p.x(), p.y(), scale, 5, 0.85));
}

Colour Lot(const TownPlan& plan, uint64_t lot, const Eigen::Vector2d& p,
           const Eigen::Vector2d& in_lot, const TextureScale& scale) {
  const Eigen::Vector2d size = plan.LotSize();
  const bool driveway = std::abs(in_lot.x() - 0.16 * size.x()) < 1.3;
  if (driveway) return Pavement(plan, p, scale);
  const bool bed = in_lot.x() > 0.8 * size.x() && Uniform(Hash(lot, 1)) < 0.5;
  if (bed) return Field(lot, p, scale);
  return Grass(lot, p, 0.75 * Uniform(Hash(lot, 2)), scale);
}

Colour Ground(const TownPlan& plan, const Eigen::Vector3d& point, const TextureScale& scale) {
  const Eigen::Vector2d p = plan.PlanFromWorld(point.head<2>());
  const auto column = static_cast<int64_t>(std::floor(p.x() / plan.block.x()));
  const auto row = static_cast<int64_t>(std::floor(p.y() / plan.block.y()));
  const Eigen::Vector2d in_block = p - plan.block.cwiseProduct(Eigen::Vector2d(column, row));
  const double to_x =
      std::min(in_block.x(), plan.block.x() - in_block.x());  // to the streets' axes
  const double to_y = std::min(in_block.y(), plan.block.y() - in_block.y());
  const double road = plan.road_width / 2;
  if (to_x < road) return Road(plan, to_x, in_block.y(), to_y, p, scale);
  if (to_y < road) return Road(plan, to_y, in_block.x(), to_x, p, scale);
  if (std::min(to_x, to_y) < plan.Setback()) return Pavement(plan, p, scale);

  const uint64_t seed = Hash(plan.seed, column, row, 13);
  switch (plan.Use(column, row)) {
    case BlockUse::kHalls:
      return std::min(to_x, to_y) < plan.Setback() + 1.5 ? Grass(seed, p, 0.2, scale)
                                                         : Road(plan, 9, 0, 0, p, scale);
    case BlockUse::kPark:
      return in_block.x() < 0.45 * plan.block.x() ? Field(seed, p, scale)
                                                  : Grass(seed, p, 0.25, scale);
    case BlockUse::kHouses:
      break;
  }
  const Eigen::Vector2d from_setback = in_block.array() - plan.Setback();
  const Eigen::Vector2d size = plan.LotSize();
  const auto lot_x = static_cast<int64_t>(from_setback.x() / size.x());
  const auto lot_y = static_cast<int64_t>(from_setback.y() / size.y());
  return Lot(plan, Hash(seed, lot_x, lot_y), p,
             from_setback - size.cwiseProduct(Eigen::Vector2d(lot_x, lot_y)), scale);
}

Colour Tiles(const Material& material, double u, double v, const TextureScale& scale) {
  constexpr double kRow = 0.42, kTile = 0.34;
  const int64_t row = Floor(v / kRow);
  const double shifted = u + (row & 1 ? kTile / 2 : 0);
  const int64_t column = Floor(shifted / kTile);
  const double resolved = Resolved(kTile, scale.footprint);
  const double tile = 0.4 * (Uniform(Hash(material.seed, row, column)) - 0.5);
  const double shade = 0.22 * (Positive(v, kRow) / kRow - 0.5);
  const double moss = 0.16 * Noise(Hash(material.seed, 1), u / 2.3, v / 2.3);
  const double grain = 0.1 * Fractal(Hash(material.seed, 2), u, v, scale, 3, 0.8);
  return Textured(material.colour, 1, resolved * (tile + shade) + moss + grain);
}

Colour Plaster(const Material& material, double u, double v, const TextureScale& scale) {
  constexpr double kStorey = 2.9, kBay = 2.6;
  const double in_bay = Positive(u, kBay), in_storey = Positive(v, kStorey);
  const double stains = 0.1 * Noise(Hash(material.seed, 1), u / 0.9, v / 2.1);
  const double grain = 0.09 * Fractal(Hash(material.seed, 2), u, v, scale, 4, 0.9);
  const bool window = std::abs(in_bay - 1.3) < 0.6 && std::abs(in_storey - 1.6) < 0.7;
  if (!window) return Textured(material.colour, 1, stains + grain);
  const bool frame = std::abs(in_bay - 1.3) > 0.48 || std::abs(in_storey - 1.6) > 0.58;
  if (frame) return Colour(0.55f, 0.53f, 0.5f);
  const auto pane = Hash(material.seed, Floor(u / kBay), Floor(v / kStorey));
  return kGlass * static_cast<float>(0.6 + 2 * Uniform(pane));
}

}  // namespace

Eigen::Vector3f Reflectance(const Material& material, const TownPlan& plan,
                            const Eigen::Vector3d& point, const TextureScale& scale) {
  const Eigen::Vector3d offset = point - material.origin;
  const double u = material.u.dot(offset), v = material.v.dot(offset);
  const uint64_t seed = material.seed;
  switch (material.substance) {
    case Substance::kGround:
      return Ground(plan, point, scale);
    case Substance::kTiles:
      return Tiles(material, u, v, scale);
    case Substance::kFlatRoof:
      return Textured(material.colour, 1,
                      0.06 * Noise(Hash(seed, 1), u / 2.7, v / 2.7) +
                          0.02 * Fractal(Hash(seed, 2), u, v, scale, 4, 0.9));
    case Substance::kGravel:
      return Textured(material.colour, 1,
                      0.1 * Noise(Hash(seed, 1), u / 3.1, v / 3.1) +
                          0.22 * Fractal(Hash(seed, 2), u, v, scale, 3, 0.8));
    case Substance::kPlaster:
      return Plaster(material, u, v, scale);
    case Substance::kPaint:
      return Textured(material.colour, 0.02, Fractal(seed, u, v, scale, 3, 1.0));
    case Substance::kLeaves: {
      double leaves = 0, size = 1.5 * scale.finest;
      for (int octave = 0; octave < 4; ++octave, size *= 2) {
        leaves += Resolved(size, scale.footprint) *
                  Noise(seed + octave, point.x() / size, point.y() / size, point.z() / size);
      }
      return Textured(material.colour, 0.42, leaves);
    }
  }
  return material.colour;
}

}  // namespace sirpy
