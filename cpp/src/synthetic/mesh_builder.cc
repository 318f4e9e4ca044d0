#include "synthetic/mesh_builder.h"

#include <cmath>
#include <map>
#include <utility>

#include <Eigen/Geometry>

#include "synthetic/noise.h"

namespace sirpy {
namespace {

constexpr double kEaves = 0.45;  // how far a roof reaches beyond the walls, m

// The look of a plane face: texture axes along a -> b and, in the plane, to the left of it.
Material OnPlane(const Material& look, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                 const Eigen::Vector3d& c) {
  Material material = look;
  material.origin = a;
  material.u = (b - a).normalized();
  material.v = (b - a).cross(c - a).cross(b - a).normalized();
  return material;
}

// A sphere of triangles with corners on the unit sphere: an octahedron, each face cut into four
// `level` times.
struct Ball {
  std::vector<Eigen::Vector3d> vertices;
  std::vector<Surface::Triangle> triangles;
};

Ball MakeBall(int level) {
  Ball ball;
  ball.vertices = {{1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  ball.triangles = {{0, 1, 4}, {1, 2, 4}, {2, 3, 4}, {3, 0, 4},
                    {1, 0, 5}, {2, 1, 5}, {3, 2, 5}, {0, 3, 5}};
  for (int i = 0; i < level; ++i) {
    std::map<std::pair<int32_t, int32_t>, int32_t> middles;
    const auto middle = [&](int32_t a, int32_t b) {
      const auto [entry, added] = middles.try_emplace(std::minmax(a, b), ball.vertices.size());
      if (added) {
        const Eigen::Vector3d sum = ball.vertices[a] + ball.vertices[b];
        ball.vertices.push_back(sum.normalized());
      }
      return entry->second;
    };
    std::vector<Surface::Triangle> finer;
    for (const Surface::Triangle& t : ball.triangles) {
      const int32_t ab = middle(t[0], t[1]), bc = middle(t[1], t[2]), ca = middle(t[2], t[0]);
      finer.insert(finer.end(), {{t[0], ab, ca}, {ab, t[1], bc}, {ca, bc, t[2]}, {ab, bc, ca}});
    }
    ball.triangles = std::move(finer);
  }
  return ball;
}

}  // namespace

Eigen::Vector2d Block::Place(double x, double y) const {
  const double c = std::cos(angle), s = std::sin(angle);
  return centre + Eigen::Vector2d(c * x - s * y, s * x + c * y);
}

Eigen::Vector3d Block::Corner(int i, double z, double margin) const {
  const double x = (i == 0 || i == 3 ? -1 : 1) * (half.x() + margin);
  const double y = (i < 2 ? -1 : 1) * (half.y() + margin);
  const Eigen::Vector2d place = Place(x, y);
  return {place.x(), place.y(), z};
}

int32_t MeshBuilder::AddMaterial(const Material& material) {
  materials.push_back(material);
  return static_cast<int32_t>(materials.size()) - 1;
}

int32_t MeshBuilder::AddVertex(const Eigen::Vector3d& vertex) {
  vertices.push_back(vertex);
  return static_cast<int32_t>(vertices.size()) - 1;
}

void MeshBuilder::AddTriangle(int32_t a, int32_t b, int32_t c, int32_t material) {
  triangles.emplace_back(a, b, c);
  material_of.push_back(material);
}

void MeshBuilder::AddQuad(const std::array<Eigen::Vector3d, 4>& corners, const Material& look) {
  const int32_t material = AddMaterial(OnPlane(look, corners[0], corners[1], corners[2]));
  const int32_t first = AddVertex(corners[0]);
  for (int i = 1; i < 4; ++i) AddVertex(corners[i]);
  AddTriangle(first, first + 1, first + 2, material);
  AddTriangle(first, first + 2, first + 3, material);
}

void MeshBuilder::AddTriangle(const std::array<Eigen::Vector3d, 3>& corners, const Material& look) {
  const int32_t material = AddMaterial(OnPlane(look, corners[0], corners[1], corners[2]));
  const int32_t first = AddVertex(corners[0]);
  AddVertex(corners[1]);
  AddVertex(corners[2]);
  AddTriangle(first, first + 1, first + 2, material);
}

void MeshBuilder::AddBox(const Block& block, const Material& wall, const Material& top) {
  for (int i = 0; i < 4; ++i) {
    const int j = (i + 1) % 4;
    AddQuad({block.Corner(i, block.bottom), block.Corner(j, block.bottom),
             block.Corner(j, block.top), block.Corner(i, block.top)},
            wall);
  }
  AddQuad({block.Corner(0, block.top), block.Corner(1, block.top), block.Corner(2, block.top),
           block.Corner(3, block.top)},
          top);
}

void MeshBuilder::AddGabled(const Block& block, double ridge, const Material& wall,
                            const Material& roof) {
  const bool along_x = block.half.x() >= block.half.y();
  const int first = along_x ? 0 : 1;  // corners first, first + 1 lie on one eave
  const double across = along_x ? block.half.y() : block.half.x();
  const double drop = kEaves * (ridge - block.top) / across;
  const auto corner = [&](int i, double z, double margin) {
    return block.Corner((first + i) % 4, z, margin);
  };
  const auto ridge_end = [&](int i, double margin) {  // above the gable between corners i and i + 1
    Eigen::Vector3d end = (corner(i, 0, margin) + corner((i + 1) % 4, 0, margin)) / 2;
    end.z() = ridge;
    return end;
  };
  for (int i = 0; i < 4; ++i) {
    AddQuad({corner(i, block.bottom, 0), corner((i + 1) % 4, block.bottom, 0),
             corner((i + 1) % 4, block.top, 0), corner(i, block.top, 0)},
            wall);
  }
  AddTriangle({corner(1, block.top, 0), corner(2, block.top, 0), ridge_end(1, 0)}, wall);
  AddTriangle({corner(3, block.top, 0), corner(0, block.top, 0), ridge_end(3, 0)}, wall);
  const double eave = block.top - drop;
  AddQuad({corner(0, eave, kEaves), corner(1, eave, kEaves), ridge_end(1, kEaves),
           ridge_end(3, kEaves)},
          roof);
  AddQuad({corner(2, eave, kEaves), corner(3, eave, kEaves), ridge_end(3, kEaves),
           ridge_end(1, kEaves)},
          roof);
}

void MeshBuilder::AddCrown(const Eigen::Vector3d& centre, const Eigen::Vector3d& radii,
                           const Material& look) {
  static const Ball ball = MakeBall(3);
  const int32_t material = AddMaterial(look);
  const auto first = static_cast<int32_t>(vertices.size());
  for (const Eigen::Vector3d& direction : ball.vertices) {
    const Eigen::Vector3d place = direction * 2.2;
    const double knob = 1 + 0.3 * Noise(look.seed, place.x(), place.y(), place.z()) +
                        0.15 * Noise(look.seed + 1, 2 * place.x(), 2 * place.y(), 2 * place.z());
    AddVertex(centre + knob * radii.cwiseProduct(direction));
  }
  for (const Surface::Triangle& t : ball.triangles) {
    AddTriangle(first + t[0], first + t[1], first + t[2], material);
  }
}

}  // namespace sirpy
