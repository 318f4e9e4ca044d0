// Where the pixels of an undistorted image lie in its photograph. The lens is sampled on a lattice
// of nodes, evenly spaced from the first to the last pixel centre of the undistorted image; between
// nodes it is a bicubic polynomial through the 4 x 4 nearest ones. Positions are in pixels, the
// centre of the top-left pixel at (0.5, 0.5), x right, y down, in the undistorted image as in the
// photograph.
#pragma once

#include <cstdint>
#include <vector>

#include <Eigen/Core>

namespace sirpy {

class LensMap {
 public:
  // nodes: node_rows x node_columns x (x, y), row-major, finite, at least 4 x 4. width, height: of
  // the undistorted image. Throws std::invalid_argument.
  LensMap(std::vector<double> nodes, int64_t node_rows, int64_t node_columns, int64_t width,
          int64_t height);

  int64_t width() const { return width_; }
  int64_t height() const { return height_; }

  // The position in the photograph of a position in the undistorted image.
  Eigen::Vector2d At(const Eigen::Vector2d& undistorted) const;

  // The pixels first_column .. first_column + count - 1 of a row, in sub-pixels (sub_pixels.h).
  void Row(int64_t row, int64_t first_column, int64_t count, int32_t* x, int32_t* y) const;

 private:
  // The positions (x, y) of all node columns at one height, interpolated between the node rows.
  std::vector<double> NodeRow(double undistorted_y) const;

  std::vector<double> nodes_;
  int64_t node_rows_;
  int64_t node_columns_;
  int64_t width_;
  int64_t height_;
  double nodes_per_pixel_x_;
  double nodes_per_pixel_y_;
};

}  // namespace sirpy
