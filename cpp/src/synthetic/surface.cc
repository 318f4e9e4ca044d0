#include "synthetic/surface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <utility>

#include <Eigen/Geometry>

#include "synthetic/noise.h"

namespace sirpy {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Whether a triangle (or the segment that it is when seen from above) meets a square, by separating
// axes.
bool MeetsSquare(const std::array<Eigen::Vector2d, 3>& corners, const Eigen::Vector2d& centre,
                 double half_side) {
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector2d edge = corners[(i + 1) % 3] - corners[i];
    const Eigen::Vector2d axis(-edge.y(), edge.x());
    const double reach = half_side * (std::abs(axis.x()) + std::abs(axis.y()));
    double low = kInfinity, high = -kInfinity;
    for (const Eigen::Vector2d& corner : corners) {
      const double position = axis.dot(corner - centre);
      low = std::min(low, position);
      high = std::max(high, position);
    }
    const double slack = 1e-9 * (reach + std::abs(low) + std::abs(high));
    if (low > reach + slack || high < -reach - slack) return false;
  }
  return true;
}

// The nearest point of a triangle (C. Ericson, "Real-time collision detection", section 5.1.5).
Eigen::Vector3d NearestOnTriangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a,
                                  const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a, ac = c - a, ap = p - a;
  const double d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Eigen::Vector3d bp = p - b;
  const double d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + d1 / (d1 - d3) * ab;
  const Eigen::Vector3d cp = p - c;
  const double d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
    return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  }
  const double scale = 1 / (va + vb + vc);
  return a + ab * (vb * scale) + ac * (vc * scale);
}

}  // namespace

Surface::Surface(std::vector<Eigen::Vector3d> vertices, std::vector<Triangle> triangles)
    : vertices_(std::move(vertices)), triangles_(std::move(triangles)) {
  if (triangles_.empty()) throw std::invalid_argument("a surface needs at least one triangle");
  minimum_.setConstant(kInfinity);
  maximum_.setConstant(-kInfinity);
  for (const Eigen::Vector3d& vertex : vertices_) {
    if (!vertex.allFinite()) throw std::invalid_argument("a vertex of the surface is not finite");
    minimum_ = minimum_.cwiseMin(vertex);
    maximum_ = maximum_.cwiseMax(vertex);
  }
  for (const Triangle& triangle : triangles_) {
    if (triangle.minCoeff() < 0 || triangle.maxCoeff() >= static_cast<int64_t>(vertices_.size())) {
      throw std::invalid_argument("a triangle of the surface names a vertex that does not exist");
    }
  }
  FillCells();
}

void Surface::FillCells() {
  // About one cell for two triangles of an even mesh, and never more than the bounded number of
  // cells.
  const Eigen::Vector2d extent = (maximum_ - minimum_).head<2>();
  const double longest = std::max(extent.maxCoeff(), 1e-9);
  const double even =
      std::sqrt(2 * extent.x() * extent.y() / static_cast<double>(triangles_.size()));
  cell_size_ = std::max(even, longest / 4096);
  columns_ = static_cast<int>(extent.x() / cell_size_) + 1;
  rows_ = static_cast<int>(extent.y() / cell_size_) + 1;
  cells_.assign(static_cast<size_t>(columns_) * rows_, Cell());

  cell_begin_.assign(cells_.size() + 1, 0);
  const auto count = static_cast<int32_t>(triangles_.size());
  for (int32_t triangle = 0; triangle < count; ++triangle) {
    double z_min = kInfinity, z_max = -kInfinity;
    for (const int32_t index : triangles_[triangle]) {
      z_min = std::min(z_min, vertices_[index].z());
      z_max = std::max(z_max, vertices_[index].z());
    }
    ForCellsOf(triangle, [&](size_t cell) {
      // Rounded outwards: the bounds must hold in single precision too.
      cells_[cell].z_min =
          std::min(cells_[cell].z_min, std::nextafter(static_cast<float>(z_min), -INFINITY));
      cells_[cell].z_max =
          std::max(cells_[cell].z_max, std::nextafter(static_cast<float>(z_max), INFINITY));
      ++cell_begin_[cell + 1];
    });
  }
  for (size_t cell = 0; cell < cells_.size(); ++cell) cell_begin_[cell + 1] += cell_begin_[cell];
  cell_triangles_.resize(cell_begin_.back());
  std::vector<uint32_t> next(cell_begin_.begin(), cell_begin_.end() - 1);
  for (int32_t triangle = 0; triangle < count; ++triangle) {
    ForCellsOf(triangle, [&](size_t cell) { cell_triangles_[next[cell]++] = triangle; });
  }
}

Eigen::Vector2i Surface::CellOf(double x, double y) const {
  const auto index = [this](double offset, int cells) {
    // In this order: max(0, NaN) is 0.
    return static_cast<int>(std::min(std::max(0.0, std::floor(offset / cell_size_)), cells - 1.0));
  };
  return {index(x - minimum_.x(), columns_), index(y - minimum_.y(), rows_)};
}

template <typename Visit>
void Surface::ForCellsOf(int32_t triangle, const Visit& visit) const {
  std::array<Eigen::Vector2d, 3> corners;
  for (int i = 0; i < 3; ++i) corners[i] = vertices_[triangles_[triangle][i]].head<2>();
  const Eigen::Vector2d low = corners[0].cwiseMin(corners[1]).cwiseMin(corners[2]);
  const Eigen::Vector2d high = corners[0].cwiseMax(corners[1]).cwiseMax(corners[2]);
  // A hair beyond, so that a triangle on the border of two cells is in both.
  const double slack = 1e-9 * cell_size_;
  const Eigen::Vector2i first = CellOf(low.x() - slack, low.y() - slack);
  const Eigen::Vector2i last = CellOf(high.x() + slack, high.y() + slack);
  for (int row = first.y(); row <= last.y(); ++row) {
    for (int column = first.x(); column <= last.x(); ++column) {
      const Eigen::Vector2d centre =
          minimum_.head<2>() + cell_size_ * Eigen::Vector2d(column + 0.5, row + 0.5);
      if (MeetsSquare(corners, centre, cell_size_ / 2)) visit(IndexOf(column, row));
    }
  }
}

Eigen::Vector3d Surface::Normal(int32_t triangle) const {
  const Triangle& corners = triangles_[triangle];
  const Eigen::Vector3d& a = vertices_[corners[0]];
  return (vertices_[corners[1]] - a).cross(vertices_[corners[2]] - a).normalized();
}

// T. Moller, B. Trumbore, "Fast, minimum storage ray/triangle intersection", 1997; both sides are
// hit.
double Surface::Intersect(int32_t triangle, const Eigen::Vector3d& origin,
                          const Eigen::Vector3d& direction) const {
  constexpr double kSlack = 1e-10;  // neighbouring triangles overlap by a hair rather than leak
  const Triangle& corners = triangles_[triangle];
  const Eigen::Vector3d& a = vertices_[corners[0]];
  const Eigen::Vector3d ab = vertices_[corners[1]] - a, ac = vertices_[corners[2]] - a;
  const Eigen::Vector3d p = direction.cross(ac);
  const double determinant = ab.dot(p);
  if (determinant == 0) return kInfinity;
  const double inverse = 1 / determinant;
  const Eigen::Vector3d s = origin - a;
  const double u = s.dot(p) * inverse;
  if (u < -kSlack || u > 1 + kSlack) return kInfinity;
  const Eigen::Vector3d q = s.cross(ab);
  const double v = direction.dot(q) * inverse;
  if (v < -kSlack || u + v > 1 + kSlack) return kInfinity;
  return ac.dot(q) * inverse;
}

RayHit Surface::Cast(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double t_min,
                     double t_max) const {
  RayHit hit;
  double t = t_min, t_end = t_max;
  for (int i = 0; i < 3; ++i) {  // the part of the ray inside the bounding box
    if (direction[i] == 0) {
      if (origin[i] < minimum_[i] || origin[i] > maximum_[i]) return hit;
      continue;
    }
    const double low = (minimum_[i] - origin[i]) / direction[i];
    const double high = (maximum_[i] - origin[i]) / direction[i];
    t = std::max(t, std::min(low, high));
    t_end = std::min(t_end, std::max(low, high));
  }
  // A flat mesh has a box without height: rounding must not lose its hits.
  t_end += 1e-9 * (1 + std::abs(t_end));
  t -= 1e-9 * (1 + std::abs(t));
  if (!(t <= t_end)) return hit;

  const Eigen::Vector3d entry = origin + t * direction;
  Eigen::Vector2i cell = CellOf(entry.x(), entry.y());
  Eigen::Vector2i step;
  Eigen::Vector2d t_next, t_cell;  // t at the next border, t across a cell, for x and y
  for (int i = 0; i < 2; ++i) {
    step[i] = direction[i] > 0 ? 1 : -1;
    const double border = minimum_[i] + (cell[i] + (step[i] > 0 ? 1 : 0)) * cell_size_;
    t_next[i] = direction[i] == 0 ? kInfinity : (border - origin[i]) / direction[i];
    t_cell[i] = direction[i] == 0 ? kInfinity : cell_size_ / std::abs(direction[i]);
  }
  while (true) {
    const int axis = t_next.x() < t_next.y() ? 0 : 1;
    const double t_exit = std::min(t_next[axis], t_end);
    const size_t index = IndexOf(cell.x(), cell.y());
    const double z_enter = origin.z() + t * direction.z();
    const double z_exit = origin.z() + t_exit * direction.z();
    const double slack = 1e-9 * (1 + std::abs(z_enter) + std::abs(z_exit));
    if (std::min(z_enter, z_exit) - slack <= cells_[index].z_max &&
        std::max(z_enter, z_exit) + slack >= cells_[index].z_min) {
      for (uint32_t i = cell_begin_[index]; i < cell_begin_[index + 1]; ++i) {
        const double t_triangle = Intersect(cell_triangles_[i], origin, direction);
        if (t_triangle > t_min && t_triangle < t_max && t_triangle < hit.t) {
          hit.t = t_triangle;
          hit.triangle = cell_triangles_[i];
        }
      }
    }
    // A hit beyond this cell may be hidden by a triangle of a cell in between.
    if (hit.t <= t_exit || t_exit >= t_end) return hit;
    t = t_exit;
    cell[axis] += step[axis];
    t_next[axis] += t_cell[axis];
    if (cell.x() < 0 || cell.y() < 0 || cell.x() >= columns_ || cell.y() >= rows_) return hit;
  }
}

bool Surface::Sees(const Eigen::Vector3d& viewpoint, const Eigen::Vector3d& point,
                   double tolerance) const {
  const Eigen::Vector3d direction = point - viewpoint;
  const double length = direction.norm();
  return length <= tolerance || Cast(viewpoint, direction, 0, 1 - tolerance / length).triangle < 0;
}

double Surface::SquaredDistance(int32_t triangle, const Eigen::Vector3d& point) const {
  const Triangle& corners = triangles_[triangle];
  return (NearestOnTriangle(point, vertices_[corners[0]], vertices_[corners[1]],
                            vertices_[corners[2]]) -
          point)
      .squaredNorm();
}

double Surface::Distance(const Eigen::Vector3d& point, double limit) const {
  const Eigen::Vector2i centre = CellOf(point.x(), point.y());
  double best = limit * limit;
  bool found = false;
  // Rings of cells around the point; those of ring r are at least r - 1 cells away.
  for (int ring = 0; ring <= std::max(columns_, rows_); ++ring) {
    const double nearest = std::max(0, ring - 1) * cell_size_;
    if (nearest * nearest > best) break;
    for (int row = centre.y() - ring; row <= centre.y() + ring; ++row) {
      if (row < 0 || row >= rows_) continue;
      const bool whole_row = row == centre.y() - ring || row == centre.y() + ring;
      const int step = whole_row ? 1 : std::max(1, 2 * ring);
      for (int column = centre.x() - ring; column <= centre.x() + ring; column += step) {
        if (column < 0 || column >= columns_) continue;
        const size_t index = IndexOf(column, row);
        const double height =
            std::max({cells_[index].z_min - point.z(), point.z() - cells_[index].z_max, 0.0});
        if (height * height > best) continue;
        for (uint32_t i = cell_begin_[index]; i < cell_begin_[index + 1]; ++i) {
          const double squared = SquaredDistance(cell_triangles_[i], point);
          if (squared > best) continue;
          best = squared;
          found = true;
        }
      }
    }
  }
  return found ? std::sqrt(best) : kInfinity;
}

SurfaceSamples Surface::Sample(double spacing, uint64_t seed, const Eigen::Vector2d& minimum,
                               const Eigen::Vector2d& maximum) const {
  if (!(spacing > 0)) throw std::invalid_argument("the spacing of surface samples must be above 0");
  SurfaceSamples samples;
  for (size_t triangle = 0; triangle < triangles_.size(); ++triangle) {
    const Triangle& corners = triangles_[triangle];
    const Eigen::Vector3d& a = vertices_[corners[0]];
    const Eigen::Vector3d ab = vertices_[corners[1]] - a, ac = vertices_[corners[2]] - a;
    const Eigen::Vector3d cross = ab.cross(ac);
    const double expected = cross.norm() / 2 / (spacing * spacing);
    const auto count = static_cast<int64_t>(expected + Uniform(Hash(seed, triangle, -1)));
    for (int64_t i = 0; i < count; ++i) {
      double u = Uniform(Hash(seed, triangle, i, 0)), v = Uniform(Hash(seed, triangle, i, 1));
      if (u + v > 1) {
        u = 1 - u;
        v = 1 - v;
      }
      const Eigen::Vector3d point = a + u * ab + v * ac;
      if ((point.head<2>().array() < minimum.array()).any() ||
          (point.head<2>().array() >= maximum.array()).any()) {
        continue;
      }
      samples.points.push_back(point);
      samples.normals.push_back(cross.normalized());
    }
  }
  return samples;
}

}  // namespace sirpy
