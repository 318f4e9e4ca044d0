#include "patch_match/planar_completion.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

#include "option_bounds.h"
#include "patch_match/level.h"
#include "patch_match/random.h"

namespace sirpy {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using patch_match::kMaxSources;

constexpr int kDirections = 16;
constexpr int kSteps = 24;      // of a ray, two pixels each: 48 pixels
constexpr int kTriples = 32;    // planes that are tried
constexpr float kGood = 0.15f;  // no more are, where the misfit of one is this share of the worst
constexpr int kFits = 3;        // to the samples on the plane, each time found anew
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

// Least squares of the samples within the tolerance of `fit`, in doubles; what is fitted are their
// residuals, so nothing is lost to cancellation.
Support LeastSquares(const Samples& samples, const Fit& fit, float tolerance) {
  double sums[10] = {};  // of 1, x, y, x x, x y, y y, r, x r, y r, r r
  for (int i = 0; i < samples.count; ++i) {
    const double x = samples.x[i], y = samples.y[i];
    const double r = samples.shift[i] - fit.at - fit.across * x - fit.down * y;
    const double on = std::abs(r) <= tolerance ? 1 : 0;
    const double terms[10] = {1, x, y, x * x, x * y, y * y, r, x * r, y * r, r * r};
    for (int k = 0; k < 10; ++k) sums[k] += on * terms[k];
  }
  Support support;
  support.count = int(sums[0]);
  if (support.count < 4) return support;
  Matrix3d normal;
  normal << sums[0], sums[1], sums[2], sums[1], sums[3], sums[4], sums[2], sums[4], sums[5];
  const Vector3d right(sums[6], sums[7], sums[8]);
  const Eigen::LDLT<Matrix3d> solver(normal);
  if (!(solver.rcond() > 1e-9)) return support;  // nearly on one line
  const Vector3d correction = solver.solve(right);
  support.plane = Vector3d(fit.at, fit.across, fit.down) + correction;
  const double variance = std::max(sums[9] - correction.dot(right), 0.0) / (support.count - 3);
  support.error = std::sqrt(variance * solver.solve(Vector3d::UnitX())(0));
  return support;
}

// What is known of a pixel: what the pass found, or the plane that it has been given.
struct Evidence {
  float rho = 0;      // inverse depth of a reliable pixel, otherwise 0
  float texture = 0;  // 0: of a plane around
};

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
        evidence_(size_t(width_) * height_),
        result_{{maps.depth, maps.depth + maps.window.Area()},
                {maps.normal, maps.normal + 3 * maps.window.Area()},
                std::vector<uint8_t>(size_t(width_) * height_, 0)} {
    const double scale = 1.0 / (1 << maps.level);
    fx_ = maps.intrinsics(0, 0) * scale;
    fy_ = maps.intrinsics(1, 1) * scale;
    cx_ = maps.intrinsics(0, 2) * scale - 0.5 - double(maps.window.x0);
    cy_ = maps.intrinsics(1, 2) * scale - 0.5 - double(maps.window.y0);
    for (size_t i = 0; i < evidence_.size(); ++i) {
      const bool reliable = maps.depth[i] > 0 && maps.num_consistent[i] >= options.min_consistent;
      evidence_[i] = {reliable ? 1 / maps.depth[i] : 0, maps.texture[i]};
    }
  }

  PlanarCompletion Run() && {
    const int threads = options_.threads > 0 ? options_.threads : omp_get_num_procs();
    for (int round = 0; round < options_.rounds; ++round) {
#pragma omp parallel for schedule(dynamic) num_threads(threads)
      for (int y = 0; y < height_; ++y) CompleteRow(y);
      for (size_t i = 0; i < evidence_.size(); ++i) {
        if (result_.completed[i]) evidence_[i] = {1 / result_.depth[i], 0};
      }
    }
    return std::move(result_);
  }

 private:
  void CompleteRow(int y) {
    Samples samples;
    for (int x = 0; x < width_; ++x) {
      const Evidence& own = evidence_[int64_t(y) * width_ + x];
      if (own.rho > 0 && own.texture > options_.edge_texture) continue;
      const double motion = Motion(x, y);
      // The less contrast in the patches, the less they know of what is beside the surface.
      for (const double texture : {options_.weak_texture / 4, options_.weak_texture}) {
        Collect(x, y, float(motion), float(texture), &samples);
        const Support support = BestPlane(samples, x, y);
        if (!Suffices(support, samples.count)) continue;
        Store(support.plane / motion, x, y);
        break;
      }
    }
  }

  bool Suffices(const Support& support, int num_samples) const {
    return support.count >= options_.min_samples &&
           support.count >= options_.min_share * num_samples &&
           support.error <= options_.max_error && support.plane(0) > 0;
  }

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

  // Reliable pixels that lie as it were on the same surface, with no more texture than this.
  void Collect(int x, int y, float motion, float texture, Samples* samples) const {
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
        const Evidence& evidence = evidence_[at];
        if (!(evidence.rho > 0) || evidence.texture > texture) continue;
        samples->x[samples->count] = float(offset.dx);
        samples->y[samples->count] = float(offset.dy);
        samples->shift[samples->count++] = evidence.rho * motion;
      }
    }
  }

  Support BestPlane(const Samples& samples, int x, int y) const {
    const float tolerance = float(options_.tolerance);
    const uint64_t pixel =
        uint64_t(uint32_t(maps_.window.y0 + y)) << 32 | uint32_t(maps_.window.x0 + x);
    Support support;
    if (samples.count < options_.min_samples) return support;
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
      if (least <= kGood * tolerance * tolerance * float(samples.count)) break;
    }
    if (!(least < INFINITY)) return support;
    for (int i = 0; i < kFits; ++i) {
      support = LeastSquares(samples, best, tolerance);
      if (!(support.error < INFINITY)) break;
      best = {float(support.plane(0)), float(support.plane(1)), float(support.plane(2))};
    }
    return support;
  }

  void Store(const Vector3d& plane, int x, int y) {
    const int64_t at = int64_t(y) * width_ + x, size = int64_t(width_) * height_;
    const Vector3d inward(fx_ * plane(1), fy_ * plane(2),
                          plane(0) - plane(1) * (x - cx_) - plane(2) * (y - cy_));
    const Vector3d normal = -inward.normalized();
    result_.depth[at] = float(1 / plane(0));
    for (int i = 0; i < 3; ++i) result_.normal[at + i * size] = float(normal(i));
    result_.completed[at] = 1;
  }

  const CompletionMaps& maps_;
  const PlanarCompletionOptions& options_;
  const std::vector<Vector3d>& centres_;
  int width_, height_;
  double fx_, fy_, cx_, cy_;
  std::vector<Offset> offsets_;
  std::vector<int16_t> grey_;  // 9 times the smoothed grey level
  std::vector<Evidence> evidence_;
  PlanarCompletion result_;
};

}  // namespace

void PlanarCompletionOptions::Validate() const {
  const auto require = [](bool satisfied, const std::string& field, double value,
                          const std::string& bound) {
    RequireOption(satisfied, "PlanarCompletionOptions", field, value, field + " " + bound);
  };
  require(grey_step >= 0 && grey_step <= 255, "grey_step", grey_step, "in [0, 255]");
  require(edge_texture >= 0, "edge_texture", edge_texture, ">= 0");
  require(weak_texture >= 0, "weak_texture", weak_texture, ">= 0");
  require(min_consistent >= 1, "min_consistent", min_consistent, ">= 1");
  require(tolerance > 0, "tolerance", tolerance, "> 0");
  require(min_share > 0 && min_share <= 1, "min_share", min_share, "in (0, 1]");
  require(min_samples >= 4, "min_samples", min_samples, ">= 4");
  require(max_error > 0, "max_error", max_error, "> 0");
  require(rounds >= 1, "rounds", rounds, ">= 1");
  require(threads >= 0, "threads", threads, ">= 0");
}

PlanarCompletion CompletePlanes(const CompletionMaps& maps,
                                const std::vector<Vector3d>& source_centres,
                                const PlanarCompletionOptions& options) {
  options.Validate();
  if (source_centres.size() > kMaxSources) {
    throw std::invalid_argument("CompletePlanes: at most 32 sources are possible");
  }
  return Completer(maps, source_centres, options).Run();
}

}  // namespace sirpy
