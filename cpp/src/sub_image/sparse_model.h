// A COLMAP sparse model as plain arrays. Positions `xy` are in pixels of the image, the centre of
// its top-left pixel at (0.5, 0.5); `pose` is cam_from_world as COLMAP stores it (unit quaternion
// w x y z, then translation); points are in the world frame. Only keypoints that see a point are
// here.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace sirpy {

struct ModelCamera {
  uint32_t id = 0;
  int32_t model = 0;  // COLMAP's number of the camera model
  int64_t width = 0;  // pixels
  int64_t height = 0;
  std::vector<double> parameters;
};

struct ModelImage {
  uint32_t id = 0;
  uint32_t camera_id = 0;
  std::string name;  // UTF-8
  std::array<double, 7> pose{};
};

struct SparseModel {
  std::vector<ModelCamera> cameras;
  std::vector<ModelImage> images;

  // Points: n ids, n x 3 positions, n x 3 colours, n mean reprojection errors in pixels (-1: not
  // known).
  std::vector<uint64_t> point_ids;
  std::vector<double> xyz;
  std::vector<uint8_t> rgb;
  std::vector<double> errors;

  // Observations, one image after the other: starts[i] to starts[i + 1] are those of images[i],
  // m x 2 positions and m indices of points.
  std::vector<int64_t> starts{0};
  std::vector<double> xy;
  std::vector<int32_t> point;

  // Throws std::invalid_argument when the arrays do not fit together.
  void Validate() const;
};

// Number of parameters of a camera model by COLMAP's number, -1 when there is no such model. The
// models are those of COLMAP 4.0; their meaning is left to pycolmap.
int NumCameraParameters(int32_t model);

constexpr int32_t kPinhole = 1;  // COLMAP's number of PINHOLE: fx, fy, cx, cy

}  // namespace sirpy
