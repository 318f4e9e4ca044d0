#include "synthetic/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "option_bounds.h"
#include "synthetic/mesh_builder.h"
#include "synthetic/noise.h"

namespace sirpy {
namespace {

constexpr double kFoundation = 1;  // walls reach this far below the lowest ground around them, m

// A stream of random numbers for one thing of the scene.
class Dice {
 public:
  explicit Dice(uint64_t seed) : seed_(seed) {}
  double operator()(double low, double high) {
    return low + (high - low) * Uniform(Hash(seed_, ++count_));
  }
  uint64_t Seed() { return Hash(seed_, ++count_); }
  template <size_t size>
  const Eigen::Vector3f& Pick(const std::array<Eigen::Vector3f, size>& choices) {
    return choices[Seed() % size];
  }

 private:
  uint64_t seed_;
  int64_t count_ = 0;
};

using Palette4 = std::array<Eigen::Vector3f, 4>;
const Palette4 kRoofs = {Eigen::Vector3f(0.36f, 0.13f, 0.075f),
                         {0.26f, 0.12f, 0.08f},
                         {0.13f, 0.125f, 0.13f},
                         {0.31f, 0.17f, 0.1f}};
const Palette4 kWalls = {Eigen::Vector3f(0.6f, 0.57f, 0.5f),
                         {0.55f, 0.47f, 0.33f},
                         {0.45f, 0.46f, 0.46f},
                         {0.42f, 0.25f, 0.18f}};
const Palette4 kPaints = {Eigen::Vector3f(0.5f, 0.5f, 0.5f),
                          {0.3f, 0.03f, 0.03f},
                          {0.03f, 0.06f, 0.2f},
                          {0.03f, 0.03f, 0.03f}};
const Palette4 kFoliage = {Eigen::Vector3f(0.05f, 0.09f, 0.025f),
                           {0.07f, 0.1f, 0.03f},
                           {0.04f, 0.075f, 0.035f},
                           {0.1f, 0.105f, 0.03f}};
const Eigen::Vector3f kSheet(0.42f, 0.42f, 0.41f), kPebbles(0.33f, 0.31f, 0.28f);

Material Look(Substance substance, const Eigen::Vector3f& colour, uint64_t seed) {
  Material look;
  look.substance = substance;
  look.colour = colour;
  look.seed = seed;
  return look;
}

class SceneBuilder {
 public:
  explicit SceneBuilder(const SceneOptions& options) : options_(options) {
    plan_.seed = options.seed;
    plan_.angle = 0.15 + 0.5 * Uniform(Hash(options.seed, 1));
  }

  Scene Build() {
    AddTerrain();
    // All blocks whose circumscribed circle lies in the scene.
    const double room = options_.half_extent - plan_.block.norm();
    const int reach = static_cast<int>(options_.half_extent / plan_.block.minCoeff()) + 1;
    for (int row = -reach; row < reach; ++row) {
      for (int column = -reach; column < reach; ++column) {
        const Eigen::Vector2d corner = plan_.block.cwiseProduct(Eigen::Vector2d(column, row));
        const Eigen::Vector2d middle = plan_.WorldFromPlan(corner + plan_.block / 2);
        if (middle.cwiseAbs().maxCoeff() < room) AddBlock(column, row, corner);
      }
    }
    return {plan_, options_.finest_detail,
            Surface(std::move(mesh_.vertices), std::move(mesh_.triangles)),
            std::move(mesh_.materials), std::move(mesh_.material_of)};
  }

 private:
  double Ground(const Eigen::Vector2d& world) const {
    return TerrainHeight(options_.seed, world.x(), world.y());
  }

  void AddTerrain() {
    const auto steps =
        static_cast<int32_t>(std::ceil(2 * options_.half_extent / options_.terrain_step));
    const double step = 2 * options_.half_extent / steps;
    const int32_t material = mesh_.AddMaterial(Material());
    for (int32_t row = 0; row <= steps; ++row) {
      for (int32_t column = 0; column <= steps; ++column) {
        const Eigen::Vector2d place(column * step - options_.half_extent,
                                    row * step - options_.half_extent);
        mesh_.AddVertex({place.x(), place.y(), Ground(place)});
      }
    }
    for (int32_t row = 0; row < steps; ++row) {
      for (int32_t column = 0; column < steps; ++column) {
        const int32_t a = row * (steps + 1) + column, b = a + 1, c = a + steps + 1, d = c + 1;
        mesh_.AddTriangle(a, b, d, material);
        mesh_.AddTriangle(a, d, c, material);
      }
    }
  }

  // A block at a place of the plan with its foot in the ground; heights are above the highest
  // ground.
  Block Standing(const Eigen::Vector2d& plan_place, const Eigen::Vector2d& half, double turn,
                 double height) const {
    Block block{plan_.WorldFromPlan(plan_place), half, plan_.angle + turn, 0, 0};
    double low = Ground(block.centre), high = low;
    for (int i = 0; i < 4; ++i) {
      const double ground = Ground(block.Corner(i, 0).head<2>());
      low = std::min(low, ground);
      high = std::max(high, ground);
    }
    block.bottom = low - kFoundation;
    block.top = high + height;
    return block;
  }

  void AddBlock(int64_t column, int64_t row, const Eigen::Vector2d& corner) {
    const uint64_t seed = Hash(options_.seed, column, row, 21);
    const Eigen::Vector2d inner = corner.array() + plan_.Setback();
    switch (plan_.Use(column, row)) {
      case BlockUse::kHouses:
        for (int y = 0; y < plan_.lots_y; ++y) {
          for (int x = 0; x < plan_.lots_x; ++x) {
            AddLot(inner + plan_.LotSize().cwiseProduct(Eigen::Vector2d(x, y)), Hash(seed, x, y));
          }
        }
        break;
      case BlockUse::kHalls:
        AddHalls(inner, seed);
        break;
      case BlockUse::kPark:
        AddPark(inner, seed);
        break;
    }
    AddCars(corner, Hash(seed, 99));
  }

  void AddLot(const Eigen::Vector2d& corner, uint64_t seed) {
    Dice dice(seed);
    const Eigen::Vector2d size = plan_.LotSize();
    const Eigen::Vector2d place =
        corner + size.cwiseProduct(Eigen::Vector2d(dice(0.52, 0.6), dice(0.42, 0.58)));
    if (dice(0, 1) < 0.88) AddHouse(place, Hash(seed, 1));
    for (int i = 0; i < 2; ++i) {  // along the back of the lot
      AddTree(corner + size.cwiseProduct(Eigen::Vector2d(dice(0.3, 0.95), dice(0.04, 0.1))),
              dice(1.0, 2.1), dice.Seed());
    }
  }

  void AddHouse(const Eigen::Vector2d& place, uint64_t seed) {
    Dice dice(seed);
    const double storeys = dice(0, 1) < 0.4 ? 1 : 2;
    const bool turned = dice(0, 1) < 0.4;
    Eigen::Vector2d half(dice(4.0, 5.0), dice(3.2, 4.0));
    if (turned) half = half.reverse().eval();
    const Block block = Standing(place, half, dice(-0.06, 0.06), 2.9 * storeys + dice(0.1, 0.4));
    const Material wall = Look(Substance::kPlaster, dice.Pick(kWalls), dice.Seed());
    if (dice(0, 1) < 0.25) {
      AddFlatRoofed(block, wall, dice.Seed());
      return;
    }
    const double ridge = block.top + half.minCoeff() * dice(0.55, 0.95);
    const Material roof = Look(Substance::kTiles, dice.Pick(kRoofs), dice.Seed());
    mesh_.AddGabled(block, ridge, wall, roof);
    const Eigen::Vector2d chimney = block.Place(0.4 * half.x(), 0.25 * half.y());
    mesh_.AddBox({chimney, {0.35, 0.35}, block.angle, block.top, ridge + 0.7},
                 Look(Substance::kPaint, kRoofs[1], dice.Seed()),
                 Look(Substance::kPaint, kPaints[3], dice.Seed()));
  }

  // A roof below a parapet, with machines on it: gravel, or a weakly textured sheet.
  void AddFlatRoofed(const Block& block, const Material& wall, uint64_t seed) {
    constexpr double kParapet = 0.5, kThickness = 0.3;
    Dice dice(seed);
    const bool weak = dice(0, 1) < 0.5;
    const Material roof = weak ? Look(Substance::kFlatRoof, kSheet, dice.Seed())
                               : Look(Substance::kGravel, kPebbles, dice.Seed());
    mesh_.AddBox(block, wall, roof);
    const Material rim = Look(Substance::kPaint, kSheet, dice.Seed());
    for (int side = 0; side < 4; ++side) {
      const bool along_x = side % 2 == 0;
      const double sign = side < 2 ? -1 : 1;
      const Eigen::Vector2d inset = block.half.array() - kThickness / 2;
      const Eigen::Vector2d offset =
          along_x ? Eigen::Vector2d(0, sign * inset.y()) : Eigen::Vector2d(sign * inset.x(), 0);
      const Eigen::Vector2d half =
          along_x ? Eigen::Vector2d(block.half.x(), kThickness / 2)
                  : Eigen::Vector2d(kThickness / 2, block.half.y() - kThickness);
      mesh_.AddBox(
          {block.Place(offset.x(), offset.y()), half, block.angle, block.top, block.top + kParapet},
          rim, rim);
    }
    const int machines = block.half.minCoeff() > 6 ? 5 : 1;
    for (int i = 0; i < machines; ++i) {
      const Eigen::Vector2d place =
          block.half.cwiseProduct(Eigen::Vector2d(dice(-0.7, 0.7), dice(-0.7, 0.7)));
      const Material metal = Look(Substance::kPaint, kPaints[0], dice.Seed());
      mesh_.AddBox({block.Place(place.x(), place.y()),
                    {dice(0.5, 1.2), dice(0.4, 0.9)},
                    block.angle,
                    block.top,
                    block.top + dice(0.7, 1.6)},
                   metal, metal);
    }
  }

  void AddHalls(const Eigen::Vector2d& inner, uint64_t seed) {
    Dice dice(seed);
    const Eigen::Vector2d size = plan_.block.array() - 2 * plan_.Setback();
    const Material wall = Look(Substance::kPlaster, dice.Pick(kWalls), dice.Seed());
    AddFlatRoofed(Standing(inner + size.cwiseProduct(Eigen::Vector2d(0.33, 0.5)),
                           {0.24 * size.x(), 0.34 * size.y()}, 0, dice(8, 13)),
                  wall, dice.Seed());
    AddFlatRoofed(Standing(inner + size.cwiseProduct(Eigen::Vector2d(0.78, 0.4)),
                           {0.12 * size.x(), 0.25 * size.y()}, 0, dice(4, 7)),
                  wall, dice.Seed());
    if (options_.tall > 0) AddTowers(inner, Hash(seed, 2));
  }

  // In a row along the street, before the halls.
  void AddTowers(const Eigen::Vector2d& inner, uint64_t seed) {
    Dice dice(seed);
    const Eigen::Vector2d size = plan_.block.array() - 2 * plan_.Setback();
    for (const double along : {0.06, 0.5, 0.94}) {
      const Material wall = Look(Substance::kPlaster, dice.Pick(kWalls), dice.Seed());
      AddFlatRoofed(Standing(inner + size.cwiseProduct(Eigen::Vector2d(along, 0.07)), {2, 2}, 0,
                             options_.tall * dice(0.85, 1)),
                    wall, dice.Seed());
    }
  }

  void AddPark(const Eigen::Vector2d& inner, uint64_t seed) {
    Dice dice(seed);
    const Eigen::Vector2d size = plan_.block.array() - 2 * plan_.Setback();
    if (options_.tall > 0) {
      AddWood(inner, size, dice.Seed());
      return;
    }
    for (int i = 0; i < 12; ++i) {
      const Eigen::Vector2d place(dice(0.5, 0.95), dice(0.08, 0.92));
      AddTree(inner + size.cwiseProduct(place), dice(1.5, 3.2), dice.Seed());
    }
  }

  // Slender trees that stand so close that their crowns meet.
  void AddWood(const Eigen::Vector2d& corner, const Eigen::Vector2d& size, uint64_t seed) {
    constexpr double kSpacing = 5;
    Dice dice(seed);
    for (double y = kSpacing / 2; y < size.y(); y += kSpacing) {
      for (double x = kSpacing / 2; x < size.x(); x += kSpacing) {
        const Eigen::Vector2d place =
            plan_.WorldFromPlan(corner + Eigen::Vector2d(x + dice(-1, 1), y + dice(-1, 1)));
        const double radius = dice(2.6, 3.8), half = options_.tall * dice(0.36, 0.46);
        mesh_.AddCrown({place.x(), place.y(), Ground(place) + half}, {radius, radius, half},
                       Look(Substance::kLeaves, dice.Pick(kFoliage), dice.Seed()));
      }
    }
  }

  void AddTree(const Eigen::Vector2d& plan_place, double radius, uint64_t seed) {
    Dice dice(seed);
    const Eigen::Vector2d place = plan_.WorldFromPlan(plan_place);
    const double height = radius * dice(0.9, 1.3);
    mesh_.AddCrown({place.x(), place.y(), Ground(place) + 0.9 * height}, {radius, radius, height},
                   Look(Substance::kLeaves, dice.Pick(kFoliage), dice.Seed()));
  }

  // Parked along the two streets that begin at the block's corner.
  void AddCars(const Eigen::Vector2d& corner, uint64_t seed) {
    Dice dice(seed);
    const double kerb = plan_.road_width / 2 - 1.1;
    for (int i = 0; i < 6; ++i) {
      const bool along_x = i % 2 == 0;
      const double along = 0.2 + 0.2 * (i / 2) + dice(0, 0.09);  // so that cars do not overlap
      const Eigen::Vector2d offset = along_x ? Eigen::Vector2d(along * plan_.block.x(), kerb)
                                             : Eigen::Vector2d(kerb, along * plan_.block.y());
      const double turn = (along_x ? 0 : M_PI / 2) + dice(-0.03, 0.03);
      const Material paint = Look(Substance::kPaint, dice.Pick(kPaints), dice.Seed());
      const Material glass = Look(Substance::kPaint, kPaints[3], dice.Seed());
      const Block body = Standing(corner + offset, {2.15, 0.9}, turn, 0.8);
      mesh_.AddBox(body, paint, paint);
      mesh_.AddBox({body.Place(-0.25, 0), {1.1, 0.75}, body.angle, body.top, body.top + 0.55},
                   glass, paint);
    }
  }

  SceneOptions options_;
  TownPlan plan_;
  MeshBuilder mesh_;
};

}  // namespace

void SceneOptions::Validate() const {
  const auto require = [](bool good, const std::string& field, double value,
                          const std::string& bound) {
    RequireOption(good, "SceneOptions", field, value, bound);
  };
  require(half_extent > 0 && half_extent <= 5000, "half_extent", half_extent,
          "0 < half_extent <= 5000");
  require(terrain_step >= half_extent / 2000, "terrain_step", terrain_step,
          "terrain_step >= half_extent / 2000");
  require(finest_detail > 0, "finest_detail", finest_detail, "finest_detail > 0");
  require(tall >= 0 && tall <= 1000, "tall", tall, "0 <= tall <= 1000");
}

Scene MakeScene(const SceneOptions& options) {
  options.Validate();
  return SceneBuilder(options).Build();
}

}  // namespace sirpy
