#include "synthetic/nearest.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "synthetic/noise.h"

namespace sirpy {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr int kCellsInLimit = 5;

// Points sorted by the hash of their cell: the points of one cell lie between two entries of
// `begin`. Cells that share a hash share a list, which costs time and never a wrong answer.
class CellGrid {
 public:
  CellGrid(const Eigen::Ref<const PointRows>& points, double cell_size)
      : points_(points), cell_size_(cell_size) {
    while (mask_ + 1 < static_cast<uint64_t>(points.rows())) mask_ = 2 * mask_ + 1;
    begin_.assign(mask_ + 2, 0);
    for (Eigen::Index i = 0; i < points.rows(); ++i) ++begin_[BucketOf(i) + 1];
    for (uint64_t i = 0; i <= mask_; ++i) begin_[i + 1] += begin_[i];
    order_.resize(points.rows());
    std::vector<uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (Eigen::Index i = 0; i < points.rows(); ++i) {
      order_[next[BucketOf(i)]++] = static_cast<uint32_t>(i);
    }
  }

  // Shells of cells around the query's own; those of shell r are at least r - 1 cells away.
  double Nearest(const Eigen::RowVector3d& query, double limit) const {
    double best = limit * limit;
    bool found = false;
    const Cell centre = CellOf(query);
    for (int shell = 0; shell <= kCellsInLimit + 1; ++shell) {
      const double nearest = std::max(0, shell - 1) * cell_size_;
      if (nearest * nearest > best) break;
      for (int dz = -shell; dz <= shell; ++dz) {
        for (int dy = -shell; dy <= shell; ++dy) {
          const bool face = std::abs(dz) == shell || std::abs(dy) == shell;
          for (int dx = -shell; dx <= shell; dx += face || shell == 0 ? 1 : 2 * shell) {
            const Cell cell = centre + Cell(dx, dy, dz);
            const uint64_t bucket = BucketOf(cell);
            for (uint32_t i = begin_[bucket]; i < begin_[bucket + 1]; ++i) {
              const double squared = (points_.row(order_[i]) - query).squaredNorm();
              if (squared > best) continue;
              best = squared;
              found = true;
            }
          }
        }
      }
    }
    return found ? std::sqrt(best) : kInfinity;
  }

 private:
  using Cell = Eigen::Array<int64_t, 1, 3>;

  Cell CellOf(const Eigen::RowVector3d& point) const {
    return (point / cell_size_).array().floor().cast<int64_t>();
  }
  uint64_t BucketOf(const Cell& cell) const { return Hash(0, cell[0], cell[1], cell[2]) & mask_; }
  uint64_t BucketOf(Eigen::Index point) const { return BucketOf(CellOf(points_.row(point))); }

  Eigen::Ref<const PointRows> points_;
  double cell_size_;
  uint64_t mask_ = 0;
  std::vector<uint32_t> begin_;
  std::vector<uint32_t> order_;
};

}  // namespace

Eigen::VectorXd NearestDistances(const Eigen::Ref<const PointRows>& queries,
                                 const Eigen::Ref<const PointRows>& points, double limit) {
  if (!(limit > 0) || !std::isfinite(limit)) {
    throw std::invalid_argument("limit of a nearest-point search must be above 0 and finite");
  }
  const CellGrid grid(points, limit / kCellsInLimit);
  Eigen::VectorXd distances(queries.rows());
#pragma omp parallel for schedule(dynamic, 1024)
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    distances[i] = grid.Nearest(queries.row(i), limit);
  }
  return distances;
}

}  // namespace sirpy
