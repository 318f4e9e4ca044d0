#include "patch_match/initialise.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "patch_match/random.h"

namespace sirpy::patch_match {
namespace {

// The gradient of inverse depth of the plane with inverse depth rho at native pixel (x, y) and the
// given normal: inverse depth is m . x~ with m along K^-T n.
Eigen::Vector2f Gradient(const Level& level, double x, double y, double rho,
                         const Eigen::Vector3d& normal) {
  const double mx = normal.x() / level.fx, my = normal.y() / level.fy;
  const double at_pixel = mx * (x - level.cx) + my * (y - level.cy) + normal.z();
  return Eigen::Vector2d(mx, my).cast<float>() * float(rho / at_pixel);
}

// The first of random points of a cube that lies in its ball, on the sphere. Sine and cosine would
// differ from one C library to another.
template <typename Draw>
Eigen::Vector3d RandomDirection(const Draw& draw, int first) {
  for (int i = first;; i += 3) {
    const Eigen::Vector3d point(2 * draw(i) - 1, 2 * draw(i + 1) - 1, 2 * draw(i + 2) - 1);
    const double length = point.norm();
    if (length > 0.1 && length < 1) return point / length;
  }
}

}  // namespace

PlaneArrays::PlaneArrays(const Level& level)
    : width(level.width),
      height(level.height),
      rho(size_t(width) * height),
      gx(rho.size(), 0),
      gy(rho.size(), 0),
      cost(rho.size(), 4 * kWorstCost),
      views(rho.size(), 0) {
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Block& block = level.BlockAt(x, y);
      rho[size_t(y) * width + x] = 0.5f * (block.min_inverse_depth + block.max_inverse_depth);
    }
  }
}

RandomPlanes::RandomPlanes(const Level& level, const std::vector<SparsePoint>& points, double scale)
    : level_(level), first_column_(level.x0 / kCell), first_row_(level.y0 / kCell) {
  if (points.empty()) return;
  cells_across_ = (level.x0 + level.width - 1) / kCell - first_column_ + 1;
  const int cells_down = (level.y0 + level.height - 1) / kCell - first_row_ + 1;
  nearest_rho_.resize(size_t(cells_across_) * cells_down);
#pragma omp parallel for schedule(dynamic)
  for (int row = 0; row < cells_down; ++row) {
    for (int column = 0; column < cells_across_; ++column) {
      const double x = (first_column_ + column + 0.5) * kCell - 0.5;
      const double y = (first_row_ + row + 0.5) * kCell - 0.5;
      double least = std::numeric_limits<double>::infinity();
      for (const SparsePoint& point : points) {
        const double dx = point.x * scale - 0.5 - x, dy = point.y * scale - 0.5 - y;
        const double distance = dx * dx + dy * dy;
        if (distance < least) {
          least = distance;
          nearest_rho_[size_t(row) * cells_across_ + column] = float(1 / point.depth);
        }
      }
    }
  }
}

size_t RandomPlanes::CellOf(int x, int y) const {
  const int row = (level_.y0 + y) / kCell - first_row_;
  const int column = (level_.x0 + x) / kCell - first_column_;
  return size_t(row) * cells_across_ + column;
}

void RandomPlanes::FillRow(int y, int candidate, const Planes& row) const {
  const bool seeded = candidate < 2 && !nearest_rho_.empty();
  for (int x = 0; x < level_.width; ++x) {
    const float low = level_.BlockAt(x, y).min_inverse_depth;
    const float high = level_.BlockAt(x, y).max_inverse_depth;
    const uint64_t pixel = uint64_t(uint32_t(level_.y0 + y)) << 32 | uint32_t(level_.x0 + x);
    const auto draw = [&](int number) {
      return Uniform(Hash(level_.seed, pixel, (uint64_t(candidate + 1) << 48) + uint64_t(number)));
    };
    float rho = low + draw(0) * (high - low);
    if (seeded) {
      const float near = nearest_rho_[CellOf(x, y)];
      rho = std::clamp(near + (draw(0) - 0.5f) * (high - low) / 8, low, high);
    }
    const double px = level_.x0 + x, py = level_.y0 + y;
    const Eigen::Vector3d ray((px - level_.cx) / level_.fx, (py - level_.cy) / level_.fy, 1);
    const Eigen::Vector3d normal = 0.95 * RandomDirection(draw, 1) - ray.normalized();
    const Eigen::Vector2f gradient = Gradient(level_, px, py, rho, normal);
    row.rho[x] = rho;
    row.gx[x] = gradient.x();
    row.gy[x] = gradient.y();
  }
}

StartPlanes::StartPlanes(const Level& level, const StartMaps& start, bool doubled)
    : level_(level), start_(start), doubled_(doubled) {}

// Pixel x lies at x / 2 - 1/4 of the coarser level: between x / 2 and its neighbour on that side.
int64_t StartPlanes::StartPixel(int position, bool other, int64_t begin, int64_t size) const {
  int64_t pixel = position;
  if (doubled_) pixel = position / 2 + (other ? (position % 2 == 0 ? -1 : 1) : 0);
  return std::clamp(pixel - begin, int64_t(0), size - 1);
}

void StartPlanes::FillKnownRow(int y, float* deviation, uint8_t* level) const {
  const Rectangle& maps = start_.rectangle;
  const int64_t sy = StartPixel(level_.y0 + y, false, maps.y0, maps.height);
  for (int x = 0; x < level_.width; ++x) {
    const int64_t sx = StartPixel(level_.x0 + x, false, maps.x0, maps.width);
    const size_t at = size_t(sy * maps.width + sx);
    const float depth = start_.depth[at];
    deviation[x] = depth > 0 ? start_.sigma[at] / (depth * depth) : 0;
    level[x] = start_.level_of[at];
  }
}

void StartPlanes::FillRow(int y, int candidate, const Planes& row) const {
  const Rectangle& maps = start_.rectangle;
  const size_t area = maps.Area();
  // The centre of a pixel of the maps, in pixels of this level.
  const auto centre = [&](int64_t pixel) { return doubled_ ? 2 * pixel + 0.5 : double(pixel); };
  const int py = level_.y0 + y;
  const int64_t sy = StartPixel(py, candidate & 2, maps.y0, maps.height);
  for (int x = 0; x < level_.width; ++x) {
    const int px = level_.x0 + x;
    const int64_t sx = StartPixel(px, candidate & 1, maps.x0, maps.width);
    const size_t at = size_t(sy * maps.width + sx);
    row.rho[x] = row.gx[x] = row.gy[x] = 0;
    row.views[x] = start_.views[at];
    if (!(start_.depth[at] > 0)) continue;
    const Eigen::Vector3d normal(start_.normal[at], start_.normal[at + area],
                                 start_.normal[at + 2 * area]);
    const double cx = centre(maps.x0 + sx), cy = centre(maps.y0 + sy);
    const double rho = 1.0 / start_.depth[at];
    const Eigen::Vector2f gradient = Gradient(level_, cx, cy, rho, normal);
    row.rho[x] = float(rho + gradient.x() * (px - cx) + gradient.y() * (py - cy));
    row.gx[x] = gradient.x();
    row.gy[x] = gradient.y();
  }
}

}  // namespace sirpy::patch_match
