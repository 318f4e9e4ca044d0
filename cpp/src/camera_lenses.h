// COLMAP's camera models with their parameters in COLMAP's order, as templates for automatic
// differentiation.
//
// Geometry: a point of the camera's frame (x right, y down, z > 0 ahead) has the direction
// (x / z, y / z); the lens distorts it, focal lengths and principal point take it to pixels, where
// the centre of the top-left pixel is at (0.5, 0.5).
#pragma once

#include <cmath>

#include <Eigen/Core>

namespace sirpy {

template <typename T>
using Direction = Eigen::Matrix<T, 2, 1>;

struct Undistorted {
  static constexpr int kParameters = 0;
  template <typename T>
  static Direction<T> Apply(const T* /*k*/, const Direction<T>& direction) {
    return direction;
  }
};

// 1 + k1 s + k2 s^2 + ... at s, without the leading 1.
template <int kTerms, typename T>
T Polynomial(const T* k, const T& s) {
  T sum = k[kTerms - 1];
  for (int i = kTerms - 2; i >= 0; --i) sum = k[i] + s * sum;
  return s * sum;
}

// k1, k2, ...
template <int kTerms>
struct RadialDistortion {
  static constexpr int kParameters = kTerms;
  template <typename T>
  static Direction<T> Apply(const T* k, const Direction<T>& direction) {
    return direction * (T(1) + Polynomial<kTerms>(k, direction.squaredNorm()));
  }
};

// k1, k2, p1, p2; with the rational denominator k3, k4, k5, k6.
template <bool kRational>
struct BrownDistortion {
  static constexpr int kParameters = kRational ? 8 : 4;
  template <typename T>
  static Direction<T> Apply(const T* k, const Direction<T>& direction) {
    const T &x = direction.x(), &y = direction.y(), &p1 = k[2], &p2 = k[3];
    const T s = direction.squaredNorm();
    T radial;
    if constexpr (kRational) {
      radial = (T(1) + s * (k[0] + s * (k[1] + s * k[4]))) / (T(1) + Polynomial<3>(k + 5, s));
    } else {
      radial = T(1) + Polynomial<2>(k, s);
    }
    const T xy = T(2) * x * y;
    return {x * radial + p1 * xy + p2 * (s + T(2) * x * x),
            y * radial + p2 * xy + p1 * (s + T(2) * y * y)};
  }
};

// Equidistant: the angle from the axis, then k1, k2, ... in its square.
template <int kTerms>
struct FisheyeDistortion {
  static constexpr int kParameters = kTerms;
  template <typename T>
  static Direction<T> Apply(const T* k, const Direction<T>& direction) {
    using std::atan;
    using std::sqrt;
    const T s = direction.squaredNorm();
    // The root has no derivative on the axis, where atan(r) / r is 1 - r^2 / 3.
    if (s < T(1e-12)) return direction * (T(1) - s / T(3));
    const T r = sqrt(s);
    const T angle = atan(r);
    return direction * (angle / r * (T(1) + Polynomial<kTerms>(k, T(angle * angle))));
  }
};

// Focal lengths (one or two), principal point, distortion.
template <int kFocals, typename Distortion>
struct Lens {
  static constexpr int kParameters = kFocals + 2 + Distortion::kParameters;
  template <typename T>
  static Direction<T> Pixel(const T* parameters, const Direction<T>& direction) {
    const T* principal_point = parameters + kFocals;
    const Direction<T> distorted = Distortion::template Apply<T>(principal_point + 2, direction);
    return {parameters[0] * distorted.x() + principal_point[0],
            parameters[kFocals - 1] * distorted.y() + principal_point[1]};
  }
};

// Calls visit(name, lens) with each camera model.
template <typename Visit>
void ForEachLens(Visit&& visit) {
  visit("SIMPLE_PINHOLE", Lens<1, Undistorted>());
  visit("PINHOLE", Lens<2, Undistorted>());
  visit("SIMPLE_RADIAL", Lens<1, RadialDistortion<1>>());
  visit("RADIAL", Lens<1, RadialDistortion<2>>());
  visit("OPENCV", Lens<2, BrownDistortion<false>>());
  visit("FULL_OPENCV", Lens<2, BrownDistortion<true>>());
  visit("SIMPLE_RADIAL_FISHEYE", Lens<1, FisheyeDistortion<1>>());
  visit("RADIAL_FISHEYE", Lens<1, FisheyeDistortion<2>>());
  visit("OPENCV_FISHEYE", Lens<2, FisheyeDistortion<4>>());
}

}  // namespace sirpy
