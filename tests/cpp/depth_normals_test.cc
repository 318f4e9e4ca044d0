#include "depth_normals.h"

#include <cmath>

#include <gtest/gtest.h>

#include "plane_scene.h"

namespace sirpy {
namespace {

constexpr int kWidth = 61, kHeight = 150;  // more than two bands

Eigen::Matrix3d Intrinsics() {
  Eigen::Matrix3d intrinsics;
  intrinsics << 400, 0, 20, 0, 390, 70, 0, 0, 1;
  return intrinsics;
}

// Depths of a window at (x0, y0) and of the pixels around it.
std::vector<float> Around(const Eigen::Vector3d& left, const Eigen::Vector3d& right, int split,
                          const Rectangle& window) {
  std::vector<float> depth;
  const Eigen::Matrix3d inverse = Intrinsics().inverse();
  for (int64_t y = window.y0 - kNormalReach; y < window.y1() + kNormalReach; ++y) {
    for (int64_t x = window.x0 - kNormalReach; x < window.x1() + kNormalReach; ++x) {
      const Eigen::Vector3d ray = inverse * Eigen::Vector3d(double(x) + 0.5, double(y) + 0.5, 1);
      depth.push_back(float(x < split ? -10 / left.dot(ray) : -14 / right.dot(ray)));
    }
  }
  return depth;
}

TEST(DepthNormals, APlaneHasItsNormalAndAnEdgeTwo) {
  const Eigen::Vector3d left = Eigen::Vector3d(0.4, 0.1, -1).normalized();
  const Eigen::Vector3d right = Eigen::Vector3d(-0.6, 0.2, -1).normalized();
  const Rectangle window{0, 0, kWidth, kHeight};
  const std::vector<float> normals =
      NormalsOfDepth(Around(left, right, 30, window).data(), window, Intrinsics(), 2);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int pixel = y * kWidth + x;
      const Eigen::Vector3d found(normals[pixel], normals[pixel + kWidth * kHeight],
                                  normals[pixel + 2 * kWidth * kHeight]);
      EXPECT_GT(found.dot(x < 30 ? left : right), 0.9999) << x << ", " << y;
    }
  }
}

TEST(DepthNormals, APartHasTheBytesOfTheWholeWithAnyThreads) {
  const Eigen::Vector3d normal = Eigen::Vector3d(0.1, -0.3, -1).normalized();
  const Rectangle window{0, 0, kWidth, kHeight};
  std::vector<float> depth = Around(normal, normal, 0, window);
  for (size_t i = 0; i < depth.size(); ++i)
    depth[i] *= float(1 + 0.01 * std::sin(7.0 * double(i * i % 1000)));
  depth[3000] = 0;
  depth[4000] = -1;
  depth[5000] = std::nanf("");
  const std::vector<float> whole = NormalsOfDepth(depth.data(), window, Intrinsics(), 1);
  const Rectangle part{10, 37, 40, 80};
  std::vector<float> around;
  for (int64_t y = part.y0; y < part.y1() + 2 * kNormalReach; ++y) {
    for (int64_t x = part.x0; x < part.x1() + 2 * kNormalReach; ++x) {
      around.push_back(depth[size_t(y * (kWidth + 2 * kNormalReach) + x)]);
    }
  }
  const std::vector<float> found = NormalsOfDepth(around.data(), part, Intrinsics(), 3);
  for (int64_t plane = 0; plane < 3; ++plane) {
    for (int64_t y = 0; y < part.height; ++y) {
      for (int64_t x = 0; x < part.width; ++x) {
        EXPECT_EQ(found[size_t((plane * part.height + y) * part.width + x)],
                  whole[size_t((plane * kHeight + part.y0 + y) * kWidth + part.x0 + x)]);
      }
    }
  }
}

}  // namespace
}  // namespace sirpy
