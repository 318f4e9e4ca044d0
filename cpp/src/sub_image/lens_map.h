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
  // Row positions are whole numbers of 1 / kSubPixels pixel.
  static constexpr int kSubPixelBits = 11;
  static constexpr int32_t kSubPixels = 1 << kSubPixelBits;
  static constexpr int kLargestSide =
      120000;  // pixels of a photograph: sub-pixels fit into 32 bits

  // nodes: node_rows x node_columns x (x, y), row-major, finite, at least 4 x 4. width, height: of
  // the undistorted image. Throws std::invalid_argument.
  LensMap(std::vector<double> nodes, int64_t node_rows, int64_t node_columns, int64_t width,
          int64_t height);

  int64_t width() const { return width_; }
  int64_t height() const { return height_; }

  // The position in the photograph of a position in the undistorted image.
  Eigen::Vector2d At(const Eigen::Vector2d& undistorted) const;

  // The pixels of a row: x[column], y[column] = kSubPixels * (position - 0.5), rounded, so that
  // pixel (i, j) of the photograph has its centre at (kSubPixels * i, kSubPixels * j).
  void Row(int64_t row, int32_t* __restrict x, int32_t* __restrict y) const;

 private:
  // Cubic polynomials of a row of node columns: x and y alternate.
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
