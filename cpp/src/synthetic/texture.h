// What the surfaces of a synthetic scene are made of: diffuse reflectance (linear RGB, 0 .. 1) at a
// point of the world, in metres, with detail down to the finest size that the camera resolves.
#pragma once

#include <cstdint>

#include <Eigen/Core>

#include "synthetic/town.h"

namespace sirpy {

enum class Substance {
  kGround,    // roads, pavements, lawns, fields: what the town plan says
  kTiles,     // rows of roof tiles
  kFlatRoof,  // sheet with faint stains: weakly textured
  kGravel,    // gravelled roof
  kPlaster,   // wall with windows
  kPaint,     // cars, metal boxes: one colour
  kLeaves,
};

// A substance on one plane. Texture coordinates of a point p: (u . (p - origin), v . (p - origin)),
// metres.
struct Material {
  Substance substance = Substance::kGround;
  Eigen::Vector3f colour = Eigen::Vector3f::Constant(0.3f);
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();
  uint64_t seed = 0;
};

struct TextureScale {
  double finest = 0.1;     // size of the smallest detail, m
  double footprint = 0.1;  // size of a pixel on the surface, m: smaller detail is faded out
};

Eigen::Vector3f Reflectance(const Material& material, const TownPlan& plan,
                            const Eigen::Vector3d& point, const TextureScale& scale);

}  // namespace sirpy
