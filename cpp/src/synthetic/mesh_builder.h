// Puts together the mesh of a scene from quads, boxes, gabled houses and crowns of trees. World
// frame, metres, z up; faces look outwards.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "synthetic/surface.h"
#include "synthetic/texture.h"

namespace sirpy {

// A rectangle on the map that stands on end: centre, half sizes along its own axes, direction of
// its x axis (radians from east), and the heights of bottom and top.
struct Block {
  Eigen::Vector2d centre;
  Eigen::Vector2d half;
  double angle;
  double bottom;
  double top;

  // Corner i of 4, counter-clockwise, moved outwards by `margin`.
  Eigen::Vector3d Corner(int i, double z, double margin = 0) const;
  Eigen::Vector2d Place(double x,
                        double y) const;  // world place of a place in the block's own axes
};

class MeshBuilder {
 public:
  // A material that all faces added with its index share.
  int32_t AddMaterial(const Material& material);
  int32_t AddVertex(const Eigen::Vector3d& vertex);
  void AddTriangle(int32_t a, int32_t b, int32_t c, int32_t material);

  // Corners counter-clockwise as seen from outside; the texture runs along a -> b from a.
  void AddQuad(const std::array<Eigen::Vector3d, 4>& corners, const Material& look);
  void AddTriangle(const std::array<Eigen::Vector3d, 3>& corners, const Material& look);
  void AddBox(const Block& block, const Material& wall, const Material& top);
  // Walls up to block.top, then a roof that rises to `ridge` along the longer axis, with eaves.
  void AddGabled(const Block& block, double ridge, const Material& wall, const Material& roof);
  // A knobbly ellipsoid.
  void AddCrown(const Eigen::Vector3d& centre, const Eigen::Vector3d& radii, const Material& look);

  std::vector<Eigen::Vector3d> vertices;
  std::vector<Surface::Triangle> triangles;
  std::vector<Material> materials;
  std::vector<int32_t> material_of;
};

}  // namespace sirpy
