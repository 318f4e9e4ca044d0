// The residuals of bundle adjustment as templates for automatic differentiation; the geometry is
// that of bundle_adjustment.h.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "camera_lenses.h"

namespace sirpy {

template <typename T>
using Vector3 = Eigen::Matrix<T, 3, 1>;

// R (point - centre) of a pose.
template <typename T>
Vector3<T> Transformed(const T* pose, const Vector3<T>& point) {
  const Eigen::Map<const Eigen::Quaternion<T>> rotation(pose);
  const Eigen::Map<const Vector3<T>> centre(pose + 4);
  return rotation * Vector3<T>(point - centre);
}

// W (observed - projected). Points behind the camera have the pixel of the line through its
// centre: the residuals stay smooth, and the loss holds those of the few such points down.
template <typename Lens>
struct Reprojection {
  Eigen::Vector2d xy;
  Eigen::Matrix<double, 2, 2, Eigen::RowMajor> whitening;

  template <typename T>
  bool operator()(const T* rig_from_world, const T* intrinsics, const T* point, T* residual) const {
    return Whitened(Transformed<T>(rig_from_world, Eigen::Map<const Vector3<T>>(point)), intrinsics,
                    residual);
  }

  template <typename T>
  bool operator()(const T* rig_from_world, const T* sensor_from_rig, const T* intrinsics,
                  const T* point, T* residual) const {
    const Vector3<T> in_rig = Transformed<T>(rig_from_world, Eigen::Map<const Vector3<T>>(point));
    return Whitened(Transformed<T>(sensor_from_rig, in_rig), intrinsics, residual);
  }

 private:
  template <typename T>
  bool Whitened(const Vector3<T>& point, const T* intrinsics, T* residual) const {
    if (point.z() == T(0)) return false;
    const Direction<T> direction = point.template head<2>() / point.z();
    const Direction<T> difference =
        xy.template cast<T>() - Lens::template Pixel<T>(intrinsics, direction);
    Eigen::Map<Direction<T>> whitened(residual);
    whitened = whitening.template cast<T>() * difference;
    return true;
  }
};

// (centre - position) / sigma.
struct CentreResidual {
  Eigen::Vector3d position;
  Eigen::Vector3d sigma;

  template <typename T>
  bool operator()(const T* rig_from_world, T* residual) const {
    return Weighted<T>(Eigen::Map<const Vector3<T>>(rig_from_world + 4), residual);
  }

  template <typename T>
  bool operator()(const T* rig_from_world, const T* sensor_from_rig, T* residual) const {
    const Eigen::Map<const Eigen::Quaternion<T>> rotation(rig_from_world);
    const Eigen::Map<const Vector3<T>> rig(rig_from_world + 4), sensor(sensor_from_rig + 4);
    return Weighted<T>(rig + rotation.conjugate() * sensor, residual);
  }

 private:
  template <typename T>
  bool Weighted(const Vector3<T>& centre, T* residual) const {
    Eigen::Map<Vector3<T>> weighted(residual);
    weighted = (centre - position.template cast<T>()).cwiseQuotient(sigma.template cast<T>());
    return true;
  }
};

}  // namespace sirpy
