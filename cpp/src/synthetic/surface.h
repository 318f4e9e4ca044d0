// A triangle mesh that answers exact geometric questions: where a ray meets it, what sees what, how
// far a point is from it. World frame, any unit of length, z up; a triangle faces the side from
// which its corners run counter-clockwise. Triangles lie in a uniform grid of cells over (x, y),
// which a ray crosses cell by cell (J. Amanatides, A. Woo, "A fast voxel traversal algorithm for
// ray tracing", 1987): aerial scenes are flat, so two dimensions are enough.
#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include <Eigen/Core>

namespace sirpy {

// The first meeting of a ray with a surface, at origin + t * direction; triangle is -1 where there
// is none.
struct RayHit {
  double t = std::numeric_limits<double>::infinity();
  int32_t triangle = -1;
};

// Points on a surface with the unit normals of their triangles, one a row.
struct SurfaceSamples {
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Vector3d> normals;
};

class Surface {
 public:
  using Triangle = Eigen::Matrix<int32_t, 3, 1>;  // indices of the corners

  // Throws std::invalid_argument when there is no triangle, an index has no vertex, or a vertex is
  // not finite.
  Surface(std::vector<Eigen::Vector3d> vertices, std::vector<Triangle> triangles);

  const std::vector<Eigen::Vector3d>& vertices() const { return vertices_; }
  const std::vector<Triangle>& triangles() const { return triangles_; }
  Eigen::Vector3d Normal(int32_t triangle) const;

  // The nearest hit with t_min < t < t_max. The direction need not have unit length.
  RayHit Cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double t_min = 0,
              double t_max = std::numeric_limits<double>::infinity()) const;

  // Whether the segment from `viewpoint` to `point` is free up to `tolerance` before the point.
  bool Sees(const Eigen::Vector3d& viewpoint, const Eigen::Vector3d& point, double tolerance) const;

  // Distance from a point to the nearest point of the surface; infinity where it is above `limit`.
  double Distance(const Eigen::Vector3d& point, double limit) const;

  // One point for each spacing^2 of area, at random places hashed from the triangle and `seed`;
  // only points with minimum <= (x, y) < maximum.
  SurfaceSamples Sample(double spacing, uint64_t seed, const Eigen::Vector2d& minimum,
                        const Eigen::Vector2d& maximum) const;

 private:
  struct Cell {
    float z_min = std::numeric_limits<float>::infinity();
    float z_max = -std::numeric_limits<float>::infinity();
  };

  Eigen::Vector2i CellOf(double x, double y) const;  // nearest cell of the grid
  size_t IndexOf(int column, int row) const { return static_cast<size_t>(row) * columns_ + column; }
  template <typename Visit>
  void ForCellsOf(int32_t triangle, const Visit& visit) const;
  void FillCells();
  double Intersect(int32_t triangle, const Eigen::Vector3d& origin,
                   const Eigen::Vector3d& direction) const;  // t, infinity where they do not meet
  double SquaredDistance(int32_t triangle, const Eigen::Vector3d& point) const;

  std::vector<Eigen::Vector3d> vertices_;
  std::vector<Triangle> triangles_;
  Eigen::Vector3d minimum_, maximum_;  // bounding box
  double cell_size_ = 0;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Cell> cells_;
  std::vector<uint32_t> cell_begin_;  // into cell_triangles_, one more than there are cells
  std::vector<int32_t> cell_triangles_;
};

}  // namespace sirpy
