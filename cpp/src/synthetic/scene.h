// A synthetic aerial scene: terrain, buildings with flat and gabled roofs, trees and cars, and
// towers and woods if asked for, as a mesh of triangles with materials. World frame: metres, x
// east, y north, z up, the middle of the scene near the origin. The mesh is the exact ground truth;
// textures change colours only, never the shape.
#pragma once

#include <cstdint>
#include <vector>

#include "synthetic/surface.h"
#include "synthetic/texture.h"
#include "synthetic/town.h"

namespace sirpy {

struct SceneOptions {
  uint64_t seed = 1;
  double half_extent = 250;    // the scene is a square from -half_extent to half_extent, m
  double terrain_step = 1;     // size of the terrain's facets, m
  double finest_detail = 0.1;  // of the textures, m: about one pixel on the ground
  double tall = 0;  // height of towers beside the halls and of woods in the parks, m; 0: neither

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;
};

struct Scene {
  TownPlan plan;
  double finest_detail;
  Surface surface;
  std::vector<Material> materials;
  std::vector<int32_t> material_of;  // of each triangle of the surface
};

Scene MakeScene(const SceneOptions& options);

}  // namespace sirpy
