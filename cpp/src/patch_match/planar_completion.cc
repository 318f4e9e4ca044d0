#include "patch_match/planar_completion.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "patch_match/random.h"

namespace sirpy {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kDirections = 16;
constexpr int kSteps = 24;    // of a ray, two pixels each: 48 pixels
constexpr int kTriples = 32;  // planes that are tried
constexpr int kFits = 3;      // to the samples on the plane, each time found anew
constexpr int kMaxSamples = kDirections * kSteps;

// The steps of the rays, from pixel to pixel of the direction rounded.
struct Offset {
  int dx, dy;
};

std::vector<Offset> RayOffsets() {
  std::vector<Offset> offsets;
  for (int direction = 0; direction < kDirections; ++direction) {
    const double angle = 2 * M_PI * direction / kDirections;
    for (int step = 1; step <= kSteps; ++step) {
      offsets.push_back({int(std::lround(2 * step * std::cos(angle))),
                         int(std::lround(2 * step * std::sin(angle)))});
    }
  }
  return offsets;
}

// Sums of 3x3 grey levels; the border is repeated.
std::vector<int16_t> Smoothed(const uint8_t* grey, int width, int height) {
  std::vector<int16_t> sums(size_t(width) * height);
#pragma omp parallel for
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      int sum = 0;
      for (int dy = -1; dy <= 1; ++dy) {
        const uint8_t* row = grey + int64_t(std::clamp(y + dy, 0, height - 1)) * width;
        for (int dx = -1; dx <= 1; ++dx) sum += row[std::clamp(x + dx, 0, width - 1)];
      }
      sums[size_t(y) * width + x] = int16_t(sum);
    }
  }
  return sums;
}

// Reliable pixels around one pixel: where they are seen from it, and their inverse depths in pixels
// of motion in the sources.
struct Samples {
  int count = 0;
  float x[kMaxSamples], y[kMaxSamples], shift[kMaxSamples];
};

// shift = at + across x + down y.
struct Fit {
  float at = 0, across = 0, down = 0;
};

float Residual(const Samples& samples, const Fit& fit, int i) {
  return std::abs(samples.shift[i] - fit.at - fit.across * samples.x[i] - fit.down * samples.y[i]);
}

// Sum of min(residual, tolerance)^2: small where many samples are close to the plane.
float Misfit(const Samples& samples, const Fit& fit, float tolerance) {
  float lanes[8] = {};  // fixed sums, so that the compiler may compute them side by side
  int i = 0;
  for (; i + 8 <= samples.count; i += 8) {
    for (int lane = 0; lane < 8; ++lane) {
      const float residual = std::min(Residual(samples, fit, i + lane), tolerance);
      lanes[lane] += residual * residual;
    }
  }
  float sum = 0;
  for (; i < samples.count; ++i) {
    const float residual = std::min(Residual(samples, fit, i), tolerance);
    sum += residual * residual;
  }
  for (const float lane : lanes) sum += lane;
  return sum;
}

bool ThroughThree(const Samples& samples, const int chosen[3], Fit* fit) {
  const float ax = samples.x[chosen[1]] - samples.x[chosen[0]],
              ay = samples.y[chosen[1]] - samples.y[chosen[0]],
              bx = samples.x[chosen[2]] - samples.x[chosen[0]],
              by = samples.y[chosen[2]] - samples.y[chosen[0]];
  const float area = ax * by - ay * bx;
  if (std::abs(area) < 8) return false;  // nearly on one line
  const float a = samples.shift[chosen[1]] - samples.shift[chosen[0]],
              b = samples.shift[chosen[2]] - samples.shift[chosen[0]];
  fit->across = (a * by - b * ay) / area;
  fit->down = (ax * b - bx * a) / area;
  fit->at = samples.shift[chosen[0]] - fit->across * samples.x[chosen[0]] -
            fit->down * samples.y[chosen[0]];
  return true;
}

struct Support {
  Vector3d plane = Vector3d::Zero();  // at, across, down
  int count = 0;                      // samples on it
  double error = INFINITY;            // standard error at the pixel
};

// Least squares of the samples within the tolerance of `fit`.
Support LeastSquares(const Samples& samples, const Fit& fit, float tolerance) {
  Support support;
  Matrix3d normal = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  for (int i = 0; i < samples.count; ++i) {
    if (Residual(samples, fit, i) > tolerance) continue;
    const Vector3d row(1, samples.x[i], samples.y[i]);
    normal += row * row.transpose();
    right += row * double(samples.shift[i]);
    ++support.count;
  }
  if (support.count < 4) return support;
  const Eigen::LDLT<Matrix3d> solver(normal);
  if (!(solver.rcond() > 1e-12)) return support;
  support.plane = solver.solve(right);
  double squares = 0;
  for (int i = 0; i < samples.count; ++i) {
    if (Residual(samples, fit, i) > tolerance) continue;
    const double residual =
        samples.shift[i] - support.plane.dot(Vector3d(1, samples.x[i], samples.y[i]));
    squares += residual * residual;
  }
  const double variance = squares / (support.count - 3);
  support.error = std::sqrt(variance * solver.solve(Vector3d::UnitX())(0));
  return support;
}

class Completer {
 public:
  Completer(const CompletionMaps& maps, const std::vector<Vector3d>& source_centres,
            const PlanarCompletionOptions& options)
      : maps_(maps),
        options_(options),
        centres_(source_centres),
        width_(int(maps.window.width)),
        height_(int(maps.window.height)),
        offsets_(RayOffsets()),
        grey_(Smoothed(maps.grey, width_, height_)),
        reliable_(size_t(width_) * height_) {
    const double scale = 1.0 / (1 << maps.level);
    fx_ = maps.intrinsics(0, 0) * scale;
    fy_ = maps.intrinsics(1, 1) * scale;
    cx_ = maps.intrinsics(0, 2) * scale - 0.5 - double(maps.window.x0);
    cy_ = maps.intrinsics(1, 2) * scale - 0.5 - double(maps.window.y0);
    for (size_t i = 0; i < reliable_.size(); ++i) {
      const bool is = maps.depth[i] > 0 && maps.num_consistent[i] >= options.min_consistent;
      reliable_[i] = is ? 1 / maps.depth[i] : 0;
    }
  }

  void CompleteRow(int y, PlanarCompletion* result) const {
    Samples samples;
    for (int x = 0; x < width_; ++x) {
      const int64_t at = int64_t(y) * width_ + x;
      if (reliable_[at] > 0 && maps_.texture[at] > options_.weak_texture) continue;
      const double motion = Motion(x, y);
      Collect(x, y, float(motion), &samples);
      if (samples.count < options_.min_samples) continue;
      const Support support = BestPlane(samples, x, y);
      if (support.count < options_.min_samples ||
          support.count < options_.min_share * samples.count ||
          !(support.error <= options_.max_error) || !(support.plane(0) > 0)) {
        continue;
      }
      Store(support.plane / motion, x, y, result);
    }
  }

 private:
  // Pixels that the image of the pixel moves in the sources it was matched in (all where there is
  // none), their mean, for one unit of inverse depth.
  double Motion(int x, int y) const {
    const Vector3d ray((x - cx_) / fx_, (y - cy_) / fy_, 1);
    const uint32_t views = maps_.views[int64_t(y) * width_ + x];
    double sum = 0;
    int count = 0;
    for (size_t j = 0; j < centres_.size(); ++j) {
      if (views != 0 && !(views >> j & 1)) continue;
      sum += ray.cross(centres_[j]).norm() / ray.norm();
      ++count;
    }
    return fx_ * sum / std::max(count, 1);
  }

  void Collect(int x, int y, float motion, Samples* samples) const {
    samples->count = 0;
    const int here = grey_[int64_t(y) * width_ + x];
    const int most = int(9 * options_.grey_step);
    for (int direction = 0; direction < kDirections; ++direction) {
      for (int step = 0; step < kSteps; ++step) {
        const Offset offset = offsets_[direction * kSteps + step];
        const int u = x + offset.dx, v = y + offset.dy;
        if (u < 0 || v < 0 || u >= width_ || v >= height_) break;
        const int64_t at = int64_t(v) * width_ + u;
        if (std::abs(grey_[at] - here) > most) break;
        if (!(reliable_[at] > 0)) continue;
        samples->x[samples->count] = float(offset.dx);
        samples->y[samples->count] = float(offset.dy);
        samples->shift[samples->count++] = reliable_[at] * motion;
      }
    }
  }

  Support BestPlane(const Samples& samples, int x, int y) const {
    const float tolerance = float(options_.tolerance);
    const uint64_t pixel =
        uint64_t(uint32_t(maps_.window.y0 + y)) << 32 | uint32_t(maps_.window.x0 + x);
    Fit best;
    float least = INFINITY;
    for (int i = 0; i < kTriples; ++i) {
      int chosen[3];
      for (int k = 0; k < 3; ++k) {
        const float uniform = patch_match::Uniform(patch_match::Hash(0, pixel, 3 * i + k));
        chosen[k] = std::min(int(uniform * float(samples.count)), samples.count - 1);
      }
      Fit fit;
      if (!ThroughThree(samples, chosen, &fit)) continue;
      const float misfit = Misfit(samples, fit, tolerance);
      if (misfit < least) {
        least = misfit;
        best = fit;
      }
    }
    Support support;
    if (!(least < INFINITY)) return support;
    for (int i = 0; i < kFits; ++i) {
      support = LeastSquares(samples, best, tolerance);
      best = {float(support.plane(0)), float(support.plane(1)), float(support.plane(2))};
    }
    return support;
  }

  void Store(const Vector3d& plane, int x, int y, PlanarCompletion* result) const {
    const int64_t at = int64_t(y) * width_ + x, size = int64_t(width_) * height_;
    const Vector3d inward(fx_ * plane(1), fy_ * plane(2),
                          plane(0) - plane(1) * (x - cx_) - plane(2) * (y - cy_));
    const Vector3d normal = -inward.normalized();
    result->depth[at] = float(1 / plane(0));
    for (int i = 0; i < 3; ++i) result->normal[at + i * size] = float(normal(i));
    result->completed[at] = 1;
  }

  const CompletionMaps& maps_;
  const PlanarCompletionOptions& options_;
  const std::vector<Vector3d>& centres_;
  int width_, height_;
  double fx_, fy_, cx_, cy_;
  std::vector<Offset> offsets_;
  std::vector<int16_t> grey_;    // 9 times the smoothed grey level
  std::vector<float> reliable_;  // inverse depth of reliable pixels, otherwise 0
};

}  // namespace

void PlanarCompletionOptions::Validate() const {
  const auto require = [](bool satisfied, const std::string& field, double value,
                          const std::string& bound) {
    if (satisfied) return;
    throw std::invalid_argument("PlanarCompletionOptions::" + field + " = " +
                                std::to_string(value) + ". Violated constraint: " + field + " " +
                                bound);
  };
  require(grey_step >= 0 && grey_step <= 255, "grey_step", grey_step, "in [0, 255]");
  require(weak_texture >= 0, "weak_texture", weak_texture, ">= 0");
  require(min_consistent >= 1, "min_consistent", min_consistent, ">= 1");
  require(tolerance > 0, "tolerance", tolerance, "> 0");
  require(min_share > 0 && min_share <= 1, "min_share", min_share, "in (0, 1]");
  require(min_samples >= 4, "min_samples", min_samples, ">= 4");
  require(max_error > 0, "max_error", max_error, "> 0");
  require(threads >= 0, "threads", threads, ">= 0");
}

PlanarCompletion CompletePlanes(const CompletionMaps& maps,
                                const std::vector<Vector3d>& source_centres,
                                const PlanarCompletionOptions& options) {
  options.Validate();
  const int64_t size = maps.window.Area();
  PlanarCompletion result{{maps.depth, maps.depth + size},
                          {maps.normal, maps.normal + 3 * size},
                          std::vector<uint8_t>(size_t(size), 0)};
  const Completer completer(maps, source_centres, options);
  const int height = int(maps.window.height);
  const int threads = options.threads > 0 ? options.threads : omp_get_num_procs();
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int y = 0; y < height; ++y) completer.CompleteRow(y, &result);
  return result;
}

}  // namespace sirpy
