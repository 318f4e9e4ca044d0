#include "sub_image/lens_map.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "sub_image/sub_pixels.h"
#include "sub_image/warp_kernels.h"

namespace sirpy {
namespace {

// c[0] + c[1] t + c[2] t^2 + c[3] t^3 through p0 .. p3 at t = 0 .. 3.
struct Cubic {
  double c[4];

  Cubic(double p0, double p1, double p2, double p3) {
    const double d1 = p1 - p0;
    const double d2 = p2 - 2 * p1 + p0;
    const double d3 = p3 - 3 * p2 + 3 * p1 - p0;
    c[0] = p0;
    c[1] = d1 - d2 / 2 + d3 / 3;
    c[2] = (d2 - d3) / 2;
    c[3] = d3 / 6;
  }

  double operator()(double t) const { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }
};

// The first of the four nodes that are nearest to a position in units of nodes.
int64_t Stencil(double position, int64_t nodes) {
  return std::clamp<int64_t>(static_cast<int64_t>(std::floor(position)) - 1, 0, nodes - 4);
}

// The value at t, in steps from the first, of the cubic through four nodes that lie `stride` apart.
double Interpolate(const double* p, int64_t stride, double t) {
  return Cubic(p[0], p[stride], p[2 * stride], p[3 * stride])(t);
}

// Nodes farther off than this (in pixels) are drawn in, so that sub-pixels never overflow 32 bits:
// a cubic through four nodes stays within 1.632 times their bound, so the bicubic within 2.67.
constexpr double kFarthest = kLargestSide;

}  // namespace

LensMap::LensMap(std::vector<double> nodes, int64_t node_rows, int64_t node_columns, int64_t width,
                 int64_t height)
    : nodes_(std::move(nodes)),
      node_rows_(node_rows),
      node_columns_(node_columns),
      width_(width),
      height_(height),
      nodes_per_pixel_x_((node_columns - 1.0) / std::max<int64_t>(width - 1, 1)),
      nodes_per_pixel_y_((node_rows - 1.0) / std::max<int64_t>(height - 1, 1)) {
  if (node_rows < 4 || node_columns < 4 || width < 1 || height < 1 ||
      static_cast<int64_t>(nodes_.size()) != node_rows * node_columns * 2) {
    throw std::invalid_argument("a lens map needs at least 4 x 4 nodes of (x, y)");
  }
  if (!std::all_of(nodes_.begin(), nodes_.end(), [](double v) { return std::isfinite(v); })) {
    throw std::invalid_argument("the nodes of a lens map must be finite");
  }
  for (double& node : nodes_) node = std::clamp(node, -kFarthest, kFarthest);
}

std::vector<double> LensMap::NodeRow(double undistorted_y) const {
  const double position = (undistorted_y - 0.5) * nodes_per_pixel_y_;
  const int64_t first = Stencil(position, node_rows_);
  const int64_t stride = 2 * node_columns_;
  const double* p = &nodes_[first * stride];
  std::vector<double> row(stride);
  for (int64_t i = 0; i < stride; ++i) {
    row[i] = Interpolate(p + i, stride, position - first);
  }
  return row;
}

Eigen::Vector2d LensMap::At(const Eigen::Vector2d& undistorted) const {
  const double row = (undistorted.y() - 0.5) * nodes_per_pixel_y_;
  const double column = (undistorted.x() - 0.5) * nodes_per_pixel_x_;
  const int64_t first_row = Stencil(row, node_rows_);
  const int64_t first_column = Stencil(column, node_columns_);
  const int64_t stride = 2 * node_columns_;
  const double* p = &nodes_[first_row * stride + 2 * first_column];
  double nodes[8];  // four columns of (x, y)
  for (int i = 0; i < 8; ++i) nodes[i] = Interpolate(p + i, stride, row - first_row);
  return {Interpolate(nodes, 2, column - first_column),
          Interpolate(nodes + 1, 2, column - first_column)};
}

void LensMap::Row(int64_t row, int64_t first_column, int64_t count, int32_t* x, int32_t* y) const {
  const std::vector<double> nodes = NodeRow(row + 0.5);
  const warp::Kernels& kernels = warp::BestKernels();
  const int64_t last_column = first_column + count;
  int64_t begin = first_column;
  for (int64_t first = 0; first + 4 <= node_columns_ && begin < last_column; ++first) {
    // The stencil that begins at `first` serves the pixels before node first + 2; the last serves
    // the rest.
    int64_t end = last_column;
    if (first + 4 < node_columns_) {
      end = std::min<int64_t>(end, std::ceil((first + 2) / nodes_per_pixel_x_));
    }
    if (end <= begin) continue;
    const double* p = &nodes[2 * first];
    const Cubic cubic_x(p[0], p[2], p[4], p[6]);
    const Cubic cubic_y(p[1], p[3], p[5], p[7]);
    kernels.positions(cubic_x.c, cubic_y.c, begin, nodes_per_pixel_x_, first, end - begin,
                      x + begin - first_column, y + begin - first_column);
    begin = end;
  }
}

}  // namespace sirpy
