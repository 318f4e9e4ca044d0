#include "depth_normals.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "is_depth.h"

namespace sirpy {
namespace {

constexpr int kRadius = 2, kSide = 2 * kRadius + 1;
constexpr double kMoment = kSide * 10.0;  // of the squares of the steps -2 to 2, over a window

// The planes of all windows whose middle lies on a row.
struct RowOfPlanes {
  std::vector<double> slope_x, slope_y,
      residual;  // of inverse depth; infinite where one is missing
};

// Sums over 5 neighbours of a row, and over 5 such rows.
class PlaneFitter {
 public:
  explicit PlaneFitter(int64_t columns) : columns_(columns), rho_(columns) {
    for (std::vector<double>& one : sums_) one.resize(columns);
  }

  // The planes of middles kRadius to columns - kRadius of the middle one of five rows of depths.
  void Fit(const float* const rows[kSide], RowOfPlanes* planes) {
    for (std::vector<double>& one : sums_) std::fill(one.begin(), one.end(), 0.0);
    for (int step = -kRadius; step <= kRadius; ++step) Add(rows[step + kRadius], step);
    for (int64_t x = kRadius; x < columns_ - kRadius; ++x) {
      const double mean = sums_[kValue][x] / (kSide * kSide);
      const double slope_x = sums_[kAlongX][x] / kMoment, slope_y = sums_[kAlongY][x] / kMoment;
      const double residual = sums_[kSquare][x] - kSide * kSide * mean * mean -
                              kMoment * (slope_x * slope_x + slope_y * slope_y);
      planes->slope_x[x] = slope_x;
      planes->slope_y[x] = slope_y;
      planes->residual[x] =
          sums_[kMissing][x] > 0 ? std::numeric_limits<double>::infinity() : residual;
    }
  }

 private:
  enum { kValue, kAlongX, kAlongY, kSquare, kMissing, kNumSums };

  void Add(const float* depth, int step) {
    for (int64_t x = 0; x < columns_; ++x) rho_[x] = IsDepth(depth[x]) ? 1.0 / depth[x] : 0.0;
    const double* rho = rho_.data();
    for (int64_t x = kRadius; x < columns_ - kRadius; ++x) {
      const double a = rho[x - 2], b = rho[x - 1], c = rho[x], d = rho[x + 1], e = rho[x + 2];
      const double sum = (a + e) + (b + d) + c;
      sums_[kValue][x] += sum;
      sums_[kAlongX][x] += 2 * (e - a) + (d - b);
      sums_[kAlongY][x] += step * sum;
      sums_[kSquare][x] += (a * a + e * e) + (b * b + d * d) + c * c;
      sums_[kMissing][x] += (a == 0) + (b == 0) + (c == 0) + (d == 0) + (e == 0);
    }
  }

  int64_t columns_;
  std::vector<double> rho_;
  std::vector<double> sums_[kNumSums];
};

}  // namespace

std::vector<float> NormalsOfDepth(const float* depth, const Rectangle& window,
                                  const Eigen::Matrix3d& intrinsics, int threads) {
  const int64_t columns = window.width + 2 * kNormalReach, area = window.Area();
  std::vector<float> normals(size_t(3 * area));
  // Bands, so that the planes of few rows are found twice; nothing depends on where they begin.
  constexpr int64_t kBand = 64;
  const int64_t bands = (window.height + kBand - 1) / kBand;
  const int workers = threads > 0 ? threads : omp_get_num_procs();
#pragma omp parallel for schedule(dynamic) num_threads(workers)
  for (int64_t band = 0; band < bands; ++band) {
    PlaneFitter fitter(columns);
    const auto empty = [&] {
      return RowOfPlanes{std::vector<double>(columns), std::vector<double>(columns),
                         std::vector<double>(columns)};
    };
    std::vector<RowOfPlanes> ring(kSide, empty());
    const int64_t begin = band * kBand, end = std::min(begin + kBand, window.height);
    // Row r of planes has its middle at row r + kRadius of `depth`, r - kRadius of the window.
    const auto fit = [&](int64_t r) {
      const float* rows[kSide];
      for (int i = 0; i < kSide; ++i) rows[i] = depth + (r + i) * columns;
      fitter.Fit(rows, &ring[size_t(r % kSide)]);
    };
    for (int64_t r = begin; r < begin + kSide - 1; ++r) fit(r);
    for (int64_t y = begin; y < end; ++y) {
      fit(y + kSide - 1);
      for (int64_t x = 0; x < window.width; ++x) {
        const float here = depth[(y + kNormalReach) * columns + x + kNormalReach];
        if (!IsDepth(here)) continue;
        double best = std::numeric_limits<double>::infinity(), slope_x = 0, slope_y = 0;
        // The middle first: it stays where nothing fits better.
        constexpr int kSteps[9][2] = {{0, 0},   {-2, 0}, {0, -2}, {0, 2}, {2, 0},
                                      {-2, -2}, {-2, 2}, {2, -2}, {2, 2}};
        for (const auto& step : kSteps) {
          const RowOfPlanes& planes = ring[size_t((y + kRadius + step[0]) % kSide)];
          const size_t at = size_t(x + kNormalReach + step[1]);
          if (!(planes.residual[at] < best)) continue;
          best = planes.residual[at];
          slope_x = planes.slope_x[at];
          slope_y = planes.slope_y[at];
        }
        const double u = double(window.x0 + x) + 0.5 - intrinsics(0, 2);
        const double v = double(window.y0 + y) + 0.5 - intrinsics(1, 2);
        const double nx = intrinsics(0, 0) * slope_x, ny = intrinsics(1, 1) * slope_y;
        const double nz = 1.0 / here - slope_x * u - slope_y * v;
        const double length = std::sqrt(nx * nx + ny * ny + nz * nz);
        const int64_t pixel = y * window.width + x;
        normals[size_t(pixel)] = float(-nx / length);
        normals[size_t(pixel + area)] = float(-ny / length);
        normals[size_t(pixel + 2 * area)] = float(-nz / length);
      }
    }
  }
  return normals;
}

}  // namespace sirpy
