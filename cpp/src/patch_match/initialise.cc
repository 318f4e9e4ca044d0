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

}  // namespace

PlaneArrays::PlaneArrays(const Level& level)
    : width(level.width),
      height(level.height),
      rho(size_t(width) * height, 0.5f * (level.min_inverse_depth + level.max_inverse_depth)),
      gx(rho.size(), 0),
      gy(rho.size(), 0),
      cost(rho.size(), 4 * kWorstCost),
      views(rho.size(), 0) {}

RandomPlanes::RandomPlanes(const Level& level, const std::vector<SparsePoint>& points)
    : level_(level), first_column_(level.x0 / kCell), first_row_(level.y0 / kCell) {
  if (points.empty()) return;
  cells_across_ = (level.x0 + level.width - 1) / kCell - first_column_ + 1;
  const int cells_down = (level.y0 + level.height - 1) / kCell - first_row_ + 1;
  nearest_rho_.resize(size_t(cells_across_) * cells_down);
  const double scale = 1.0 / (1 << level.level);
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
  const float low = level_.min_inverse_depth, high = level_.max_inverse_depth;
  const bool seeded = candidate < 2 && !nearest_rho_.empty();
  for (int x = 0; x < level_.width; ++x) {
    const uint64_t pixel = uint64_t(uint32_t(level_.y0 + y)) << 32 | uint32_t(level_.x0 + x);
    const auto draw = [&](int number) {
      return Uniform(Hash(level_.seed, pixel, (uint64_t(1) << 48) + 8 * candidate + number));
    };
    float rho = low + draw(0) * (high - low);
    if (seeded) {
      const float near = nearest_rho_[CellOf(x, y)];
      rho = std::clamp(near + (draw(0) - 0.5f) * (high - low) / 8, low, high);
    }
    const double px = level_.x0 + x, py = level_.y0 + y;
    const Eigen::Vector3d ray((px - level_.cx) / level_.fx, (py - level_.cy) / level_.fy, 1);
    const double z = 2 * draw(1) - 1, angle = 2 * M_PI * draw(2), radius = std::sqrt(1 - z * z);
    const Eigen::Vector3d on_sphere(radius * std::cos(angle), radius * std::sin(angle), z);
    const Eigen::Vector3d normal = 0.95 * on_sphere - ray.normalized();
    const Eigen::Vector2f gradient = Gradient(level_, px, py, rho, normal);
    row.rho[x] = rho;
    row.gx[x] = gradient.x();
    row.gy[x] = gradient.y();
  }
}

CoarserPlanes::CoarserPlanes(const Level& level, const PlaneArrays& coarser)
    : level_(level), coarser_(coarser) {}

void CoarserPlanes::FillRow(int y, int candidate, const Planes& row) const {
  // Pixel x of this level lies at x / 2 - 1/4 of the coarser one: between x / 2 and its neighbour
  // on the side where x lies. Windows start at even pixels, so positions in the window serve.
  const auto coarse = [](int position, bool other, int size) {
    const int nearest = position / 2;
    const int step = position % 2 == 0 ? -1 : 1;
    return std::clamp(nearest + (other ? step : 0), 0, size - 1);
  };
  const int cy = coarse(y, candidate & 2, coarser_.height);
  for (int x = 0; x < level_.width; ++x) {
    const int cx = coarse(x, candidate & 1, coarser_.width);
    const size_t at = size_t(cy) * coarser_.width + cx;
    const float dx = 0.5f * float(x) - 0.25f - float(cx), dy = 0.5f * float(y) - 0.25f - float(cy);
    row.rho[x] = coarser_.rho[at] + coarser_.gx[at] * dx + coarser_.gy[at] * dy;
    row.gx[x] = 0.5f * coarser_.gx[at];
    row.gy[x] = 0.5f * coarser_.gy[at];
  }
}

GivenPlanes::GivenPlanes(const Level& level, const float* depth, const float* normal)
    : level_(level), depth_(depth), normal_(normal) {}

void GivenPlanes::FillRow(int y, int /*candidate*/, const Planes& row) const {
  const size_t plane = size_t(level_.width) * level_.height;
  for (int x = 0; x < level_.width; ++x) {
    const size_t at = size_t(y) * level_.width + x;
    if (depth_[at] <= 0) {
      row.rho[x] = 0;  // refused by the depth range
      row.gx[x] = row.gy[x] = 0;
      continue;
    }
    const Eigen::Vector3d normal(normal_[at], normal_[at + plane], normal_[at + 2 * plane]);
    const double rho = 1.0 / depth_[at];
    const Eigen::Vector2f gradient = Gradient(level_, level_.x0 + x, level_.y0 + y, rho, normal);
    row.rho[x] = float(rho);
    row.gx[x] = gradient.x();
    row.gy[x] = gradient.y();
  }
}

}  // namespace sirpy::patch_match
