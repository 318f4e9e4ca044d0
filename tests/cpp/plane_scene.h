// Scenes that can be solved by hand: cameras in a row look down at textured planes; images and
// depths are computed in closed form. World z points away from the cameras, which stand at z = 0.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "fusion.h"
#include "patch_match_sir.h"

namespace sirpy {

// Smooth random texture: sines of many directions, wavelengths of 5 to 20 pixels at the given
// sampling.
inline double Texture(double x, double y, double per_pixel) {
  double value = 0;
  for (int i = 0; i < 24; ++i) {
    const double angle = 2.399963 * i,
                 wavelength = per_pixel * (5 + 15 * std::fmod(0.618034 * i, 1.0));
    value +=
        std::sin(2 * M_PI / wavelength * (x * std::cos(angle) + y * std::sin(angle)) + 1.7 * i * i);
  }
  return 128 + 100 * value / std::sqrt(24.0) / 1.5;
}

// Depth along the ray (x, y, 1) from a camera centre to the surface.
using Surface = std::function<double(const Eigen::Vector3d& centre, const Eigen::Vector3d& ray)>;

// The plane n . X = distance.
inline Surface PlaneSurface(const Eigen::Vector3d& normal, double distance) {
  return [=](const Eigen::Vector3d& centre, const Eigen::Vector3d& ray) {
    return (distance - normal.dot(centre)) / normal.dot(ray);
  };
}

struct RenderedView {
  Eigen::Matrix3d intrinsics;
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  int width, height;
  std::vector<uint8_t> grey;
  std::vector<float> depth, inverse_depth;
  std::vector<float> normal;  // 3 planes, camera frame; filled for single planes

  ViewWindow Window(bool with_depth = false) const {
    return {intrinsics,
            rotation,
            translation,
            0,
            {0, 0, width, height},
            grey.data(),
            with_depth ? inverse_depth.data() : nullptr};
  }
  DepthView Depths(int rank) const {
    return {intrinsics, rotation, translation, {0, 0, width, height}, rank, depth.data()};
  }
};

inline RenderedView Render(const Eigen::Vector3d& centre, const Surface& surface, int width,
                           int height, const Eigen::Vector3d& normal = {0, 0, -1}) {
  RenderedView view;
  view.intrinsics << 300, 0, width / 2.0, 0, 300, height / 2.0, 0, 0, 1;
  // A little of every rotation, so that nothing is tested on aligned axes only.
  view.rotation = Eigen::AngleAxisd(0.03 * centre.x(), Eigen::Vector3d(0.2, 1, 0.5).normalized())
                      .toRotationMatrix();
  view.translation = -view.rotation * centre;
  view.width = width;
  view.height = height;
  const size_t area = size_t(width) * height;
  view.grey.resize(area);
  view.depth.resize(area);
  view.inverse_depth.resize(area);
  view.normal.resize(3 * area);
  const Eigen::Vector3d in_camera = view.rotation * normal;
  const double per_pixel = 10.0 / 300;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector3d ray = view.rotation.transpose() * view.intrinsics.inverse() *
                                  Eigen::Vector3d(x + 0.5, y + 0.5, 1);
      const double depth = surface(centre, ray);
      const Eigen::Vector3d point = centre + depth * ray;
      const size_t at = size_t(y) * width + x;
      view.depth[at] = float(depth);
      view.inverse_depth[at] = float(1 / depth);
      view.grey[at] =
          uint8_t(std::lround(std::clamp(Texture(point.x(), point.y(), per_pixel), 0.0, 255.0)));
      for (int i = 0; i < 3; ++i) view.normal[at + i * area] = float(in_camera[i]);
    }
  }
  return view;
}

}  // namespace sirpy
