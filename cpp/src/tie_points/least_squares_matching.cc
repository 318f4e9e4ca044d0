#include "tie_points/least_squares_matching.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include <Eigen/Dense>

namespace sirpy {
namespace {

using Normal = Eigen::Matrix<double, 8, 8>;
using Unknowns = Eigen::Matrix<double, 8, 1>;

constexpr int kMaxIterations = 20;
constexpr double kConverged = 0.002;   // pixels
constexpr double kMaxStep = 2.0;       // pixels, in all: the search is good to less than one
constexpr double kPeakDistance = 3.0;  // pixels: what is nearer belongs to the same peak
// Of the scaled normal equations: smaller pivots are those of unknowns that are not determined.
constexpr double kLeastPivot = 1e-10;

// Keys' weights of four neighbours at distance `t` behind the second, and their derivatives.
void Bicubic(double t, double* weights, double* slopes) {
  weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t;
  weights[1] = (1.5 * t - 2.5) * t * t + 1.0;
  weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t;
  weights[3] = (0.5 * t - 0.5) * t * t;
  slopes[0] = (-1.5 * t + 2.0) * t - 0.5;
  slopes[1] = (4.5 * t - 5.0) * t;
  slopes[2] = (-4.5 * t + 4.0) * t + 0.5;
  slopes[3] = (1.5 * t - 1.0) * t;
}

// Value and gradient; false where pixels beyond the patch are needed.
bool Sample(const LumaPatch& patch, const Eigen::Vector2d& at, double* value,
            Eigen::Vector2d* gradient) {
  // Written so that NaN is outside.
  if (!(at.x() >= 1 && at.y() >= 1 && at.x() < patch.side - 2 && at.y() < patch.side - 2)) {
    return false;
  }
  const int x = static_cast<int>(at.x());
  const int y = static_cast<int>(at.y());
  double wx[4], sx[4], wy[4], sy[4];
  Bicubic(at.x() - x, wx, sx);
  Bicubic(at.y() - y, wy, sy);
  *value = 0;
  gradient->setZero();
  for (int j = 0; j < 4; ++j) {
    const uint16_t* row = patch.luma + (y - 1 + j) * patch.side + x - 1;
    const double across = wx[0] * row[0] + wx[1] * row[1] + wx[2] * row[2] + wx[3] * row[3];
    const double slope = sx[0] * row[0] + sx[1] * row[1] + sx[2] * row[2] + sx[3] * row[3];
    *value += wy[j] * across;
    gradient->x() += wy[j] * slope;
    gradient->y() += sy[j] * across;
  }
  return true;
}

float SampleBilinear(const LumaPatch& patch, double px, double py) {
  const int x = static_cast<int>(px);
  const int y = static_cast<int>(py);
  const float fx = static_cast<float>(px - x);
  const float fy = static_cast<float>(py - y);
  const float top = patch.At(x, y) + fx * (patch.At(x + 1, y) - patch.At(x, y));
  const float bottom = patch.At(x, y + 1) + fx * (patch.At(x + 1, y + 1) - patch.At(x, y + 1));
  return top + fy * (bottom - top);
}

bool Fits(const LumaPatch& patch, const Eigen::Vector2i& centre, int radius) {
  return centre.minCoeff() >= radius && centre.maxCoeff() + radius < patch.side;
}

struct Window {
  std::vector<float> values;  // without their mean, of length 1; empty without texture
  double variance = 0;        // before that
};

Window Normalised(const LumaPatch& patch, const Eigen::Vector2i& centre, int radius) {
  std::vector<float> window;
  double sum = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      window.push_back(patch.At(centre.x() + x, centre.y() + y));
      sum += window.back();
    }
  }
  const float mean = static_cast<float>(sum / window.size());
  double squares = 0;
  for (float& value : window) {
    value -= mean;
    squares += double{value} * value;
  }
  if (squares <= 0) return {};
  const float scale = static_cast<float>(1 / std::sqrt(squares));
  for (float& value : window) value *= scale;
  const double variance = squares / window.size();
  return {std::move(window), variance};
}

struct Peak {
  double correlation = -1;
  int x = 0;
  int y = 0;
};

// The target around the prediction, in the pixels of the reference: (2 `radius` + 1)^2 values.
// Empty where the target does not hold it.
std::vector<float> Resampled(const LumaPatch& target, const PatchMap& map, int radius) {
  const double reach = radius + 1.0;
  for (const double sx : {-reach, reach}) {
    for (const double sy : {-reach, reach}) {
      const Eigen::Vector2d corner = map.position + map.affine * Eigen::Vector2d(sx, sy);
      if (!(corner.minCoeff() >= 0 && corner.maxCoeff() < target.side - 1)) return {};
    }
  }
  std::vector<float> values;
  values.reserve((2 * radius + 1) * (2 * radius + 1));
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const Eigen::Vector2d at = map.position + map.affine * Eigen::Vector2d(x, y);
      values.push_back(SampleBilinear(target, at.x(), at.y()));
    }
  }
  return values;
}

// Normalised correlation of the window with the target at all offsets, (2 `search` + 1)^2.
std::vector<double> Correlations(const std::vector<float>& window, int radius,
                                 const std::vector<float>& target, int search) {
  const int size = 2 * radius + 1;
  const int target_size = 2 * (radius + search) + 1;
  const int offsets = 2 * search + 1;
  std::vector<double> correlations(offsets * offsets);
  for (int oy = 0; oy < offsets; ++oy) {
    for (int ox = 0; ox < offsets; ++ox) {
      // The window has no mean: the target's drops out of the product.
      double product = 0, sum = 0, squares = 0;
      for (int y = 0; y < size; ++y) {
        const float* row = &target[(oy + y) * target_size + ox];
        const float* of_window = &window[y * size];
        float row_product = 0, row_sum = 0, row_squares = 0;
        const float base = target[0];  // keeps the sums of squares small
        for (int x = 0; x < size; ++x) {
          const float value = row[x] - base;
          row_product += of_window[x] * value;
          row_sum += value;
          row_squares += value * value;
        }
        product += row_product;
        sum += row_sum;
        squares += row_squares;
      }
      const double variance = squares - sum * sum / (size * size);
      correlations[oy * offsets + ox] = variance > 0 ? product / std::sqrt(variance) : 0;
    }
  }
  return correlations;
}

// The two highest peaks, offsets relative to the prediction.
std::array<Peak, 2> Peaks(const std::vector<double>& correlations, int search) {
  const int offsets = 2 * search + 1;
  const auto at = [&](int x, int y) { return correlations[y * offsets + x]; };
  const auto is_peak = [&](int x, int y) {
    for (int j = std::max(0, y - 1); j <= std::min(offsets - 1, y + 1); ++j) {
      for (int i = std::max(0, x - 1); i <= std::min(offsets - 1, x + 1); ++i) {
        if (at(i, j) > at(x, y)) return false;
      }
    }
    return true;
  };
  Peak best;
  for (int y = 0; y < offsets; ++y) {
    for (int x = 0; x < offsets; ++x) {
      if (at(x, y) > best.correlation) best = {at(x, y), x, y};
    }
  }
  Peak second;
  for (int y = 0; y < offsets; ++y) {
    for (int x = 0; x < offsets; ++x) {
      const bool apart = std::hypot(x - best.x, y - best.y) > kPeakDistance;
      if (apart && at(x, y) > second.correlation && is_peak(x, y)) second = {at(x, y), x, y};
    }
  }
  for (Peak* peak : {&best, &second}) {
    peak->x -= search;
    peak->y -= search;
  }
  return {best, second};
}

double SaturatedShare(const LumaPatch& patch, const Eigen::Vector2i& centre, int radius) {
  int saturated = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      saturated += patch.At(centre.x() + x, centre.y() + y) >= patch.white;
    }
  }
  const int size = 2 * radius + 1;
  return static_cast<double>(saturated) / (size * size);
}

// One round of least squares: the normal equations of all pixels of the window, those in the middle
// with more weight, since the surface is flat only nearby.
struct Round {
  Normal normal = Normal::Zero();
  Unknowns right = Unknowns::Zero();
  double squares = 0;
  double weights = 0;
  double correlation = 0;
};

bool MakeRound(const LumaPatch& reference, const Eigen::Vector2i& centre, const LumaPatch& target,
               const PatchMap& map, int radius, Round* round) {
  *round = Round();
  const double falloff = -0.5 / (0.36 * radius * radius);  // a standard deviation of 0.6 radius
  double sum_r = 0, sum_t = 0, sum_rr = 0, sum_tt = 0, sum_rt = 0;
  for (int y = -radius; y <= radius; ++y) {
    for (int x = -radius; x <= radius; ++x) {
      const double value = reference.At(centre.x() + x, centre.y() + y);
      double difference;
      PatchJacobian jacobian;
      if (!PixelDifference(target, map, Eigen::Vector2d(x, y), value, &difference, &jacobian)) {
        return false;
      }
      const double weight = std::exp(falloff * (x * x + y * y));
      round->normal.selfadjointView<Eigen::Lower>().rankUpdate(jacobian.transpose(), weight);
      round->right.noalias() -= weight * difference * jacobian.transpose();
      round->squares += weight * difference * difference;
      round->weights += weight;
      const double warped = difference + value;
      sum_r += weight * value;
      sum_t += weight * warped;
      sum_rr += weight * value * value;
      sum_tt += weight * warped * warped;
      sum_rt += weight * value * warped;
    }
  }
  round->normal.triangularView<Eigen::StrictlyUpper>() = round->normal.transpose();
  const double n = round->weights;
  const double variances = (sum_rr - sum_r * sum_r / n) * (sum_tt - sum_t * sum_t / n);
  round->correlation = variances > 0 ? (sum_rt - sum_r * sum_t / n) / std::sqrt(variances) : 0;
  return true;
}

// The normal equations with all unknowns scaled to one size: that of the gain is some powers of ten
// away from that of the position.
class ScaledEquations {
 public:
  explicit ScaledEquations(const Normal& normal)
      : inverse_(normal.diagonal().cwiseMax(0).cwiseSqrt().cwiseInverse()),
        factor_(inverse_.asDiagonal() * normal * inverse_.asDiagonal()) {}

  // False where the window is flat or has an edge alone.
  bool Determined() const {
    return inverse_.allFinite() && factor_.info() == Eigen::Success &&
           factor_.matrixLLT().diagonal().minCoeff() >= std::sqrt(kLeastPivot);
  }

  Unknowns Solve(const Unknowns& right) const {
    return inverse_.asDiagonal() * factor_.solve(inverse_.asDiagonal() * right);
  }

  // Of the position, for observations of variance 1. A square, which rounding leaves symmetric and
  // not negative.
  Eigen::Matrix2d Covariance() const {
    const Eigen::Matrix<double, 8, 2> position =
        Eigen::Matrix<double, 8, 2>::Identity() * inverse_.head<2>().asDiagonal();
    const Eigen::Matrix<double, 8, 2> root = factor_.matrixL().solve(position);
    return root.transpose() * root;
  }

 private:
  Unknowns inverse_;  // of the sizes
  Eigen::LLT<Normal> factor_;
};

void Add(const Unknowns& step, PatchMap* map) {
  map->position += step.head<2>();
  map->affine(0, 0) += step[2];
  map->affine(0, 1) += step[3];
  map->affine(1, 0) += step[4];
  map->affine(1, 1) += step[5];
  map->gain += step[6];
  map->offset += step[7];
}

}  // namespace

bool PixelDifference(const LumaPatch& target, const PatchMap& map, const Eigen::Vector2d& u,
                     double reference, double* difference, PatchJacobian* jacobian) {
  double value;
  Eigen::Vector2d gradient;
  if (!Sample(target, map.position + map.affine * u, &value, &gradient)) return false;
  *difference = map.gain * value + map.offset - reference;
  gradient *= map.gain;
  *jacobian << gradient.x(), gradient.y(), gradient.x() * u.x(), gradient.x() * u.y(),
      gradient.y() * u.x(), gradient.y() * u.y(), value, 1.0;
  return true;
}

Eigen::Vector2i BestTextured(const LumaPatch& patch, const Eigen::Vector2i& start, int radius,
                             int window_radius) {
  const int reach = radius + window_radius;
  if (!Fits(patch, start, reach + 1)) return start;
  // Sums of the structure tensor over windows, by sums from the top-left corner.
  const int size = 2 * reach + 1;
  std::vector<Eigen::Array3d> sums((size + 1) * (size + 1), Eigen::Array3d::Zero());
  for (int y = 0; y < size; ++y) {
    Eigen::Array3d row = Eigen::Array3d::Zero();
    for (int x = 0; x < size; ++x) {
      const int px = start.x() - reach + x;
      const int py = start.y() - reach + y;
      const double gx = patch.At(px + 1, py) - patch.At(px - 1, py);
      const double gy = patch.At(px, py + 1) - patch.At(px, py - 1);
      row += Eigen::Array3d(gx * gx, gx * gy, gy * gy);
      sums[(y + 1) * (size + 1) + x + 1] = sums[y * (size + 1) + x + 1] + row;
    }
  }
  Eigen::Vector2i best = start;
  double strength = -1;
  const int window = 2 * window_radius + 1;
  for (int y = 0; y <= 2 * radius; ++y) {
    for (int x = 0; x <= 2 * radius; ++x) {
      const auto sum = [&](int i, int j) { return sums[j * (size + 1) + i]; };
      const Eigen::Array3d t =
          sum(x + window, y + window) - sum(x, y + window) - sum(x + window, y) + sum(x, y);
      const double half = 0.5 * (t[0] - t[2]);
      const double least = 0.5 * (t[0] + t[2]) - std::sqrt(half * half + t[1] * t[1]);
      if (least > strength) {
        strength = least;
        best = start + Eigen::Vector2i(x - radius, y - radius);
      }
    }
  }
  return best;
}

PatchMatch MatchPatch(const LumaPatch& reference, const Eigen::Vector2i& centre,
                      const LumaPatch& target, const PatchMap& predicted,
                      const MatchingOptions& options) {
  PatchMatch match;
  match.map = predicted;
  const int radius = options.radius, search = options.search_radius;
  if (!Fits(reference, centre, radius)) return match;
  const std::vector<float> resampled = Resampled(target, predicted, radius + search);
  if (resampled.empty()) return match;
  if (SaturatedShare(reference, centre, radius) > options.max_saturated) {
    match.status = MatchStatus::kSaturated;
    return match;
  }
  const Window window = Normalised(reference, centre, radius);
  if (window.values.empty()) {
    match.status = MatchStatus::kWeak;
    return match;
  }
  const auto [best, rival] = Peaks(Correlations(window.values, radius, resampled, search), search);
  match.correlation = best.correlation;
  match.status = MatchStatus::kUnlike;
  // Before the shape is adjusted the best place may look a little less alike.
  if (best.correlation < options.min_correlation - 0.2) return match;
  match.status = MatchStatus::kAmbiguous;
  // What looks the same in all grey levels differs by less than they tell.
  const double rounding = options.grey_level * options.grey_level / 12;
  const double least = rounding / window.variance;
  const auto distance = [least](const Peak& peak) { return std::max(1 - peak.correlation, least); };
  if (distance(best) > options.max_rival * distance(rival)) return match;
  match.status = MatchStatus::kDistorted;
  if (std::max(std::abs(best.x), std::abs(best.y)) == search) return match;

  const Eigen::Vector2d found =
      predicted.position + predicted.affine * Eigen::Vector2d(best.x, best.y);
  match.map.position = found;
  const Eigen::Vector2i nearest = found.array().round().cast<int>();
  if (Fits(target, nearest, radius) &&
      SaturatedShare(target, nearest, radius) > options.max_saturated) {
    match.status = MatchStatus::kSaturated;
    return match;
  }
  Round round;
  bool converged = false;
  for (int i = 0; i < kMaxIterations; ++i) {
    if (!MakeRound(reference, centre, target, match.map, radius, &round)) {
      match.status = MatchStatus::kOutside;
      return match;
    }
    if (converged) break;
    const ScaledEquations equations(round.normal);
    if (!equations.Determined()) {
      match.status = MatchStatus::kWeak;
      return match;
    }
    const Unknowns step = equations.Solve(round.right);
    Add(step, &match.map);
    if ((match.map.position - found).norm() > kMaxStep * predicted.affine.norm()) return match;
    converged = step.head<2>().norm() < kConverged;
  }
  match.correlation = round.correlation;
  if (!converged) return match;
  const Eigen::Matrix2d distortion =
      predicted.affine.inverse() * match.map.affine - Eigen::Matrix2d::Identity();
  // Written so that NaN is too far.
  if (!(distortion.norm() <= options.max_distortion && match.map.gain > 0)) return match;
  match.status = MatchStatus::kUnlike;
  if (round.correlation < options.min_correlation) return match;
  match.status = MatchStatus::kWeak;
  const ScaledEquations equations(round.normal);
  if (!equations.Determined()) return match;
  // Residuals of zero are those of a posterised photograph, not of a perfect one.
  const double variance = std::max(round.squares / std::max(1.0, round.weights - 8), rounding);
  match.covariance = variance * equations.Covariance();
  const double largest = match.covariance.selfadjointView<Eigen::Lower>().eigenvalues().maxCoeff();
  if (!(largest <= options.max_deviation * options.max_deviation)) return match;
  match.status = MatchStatus::kMatched;
  return match;
}

}  // namespace sirpy
