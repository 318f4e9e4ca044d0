#include "sub_image/lens_map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

#include "sub_image/sub_pixels.h"

namespace sirpy {
namespace {

// Nodes of x' = f(x, y), y' = g(x, y) for an undistorted image of width x height pixels.
template <typename F, typename G>
std::vector<double> Nodes(int64_t rows, int64_t columns, int64_t width, int64_t height, F f, G g) {
  std::vector<double> nodes;
  for (int64_t row = 0; row < rows; ++row) {
    for (int64_t column = 0; column < columns; ++column) {
      const double x = 0.5 + (width - 1.0) * column / (columns - 1.0);
      const double y = 0.5 + (height - 1.0) * row / (rows - 1.0);
      nodes.push_back(f(x, y));
      nodes.push_back(g(x, y));
    }
  }
  return nodes;
}

double F(double x, double y) { return x + 1e-5 * x * x * x - 1e-3 * x * y * y + 3; }
double G(double x, double y) { return y - 2e-5 * y * y * x + 1e-5 * x * x * x - 2; }

TEST(LensMap, CubicLensIsExact) {
  const LensMap lens(Nodes(5, 7, 60, 40, F, G), 5, 7, 60, 40);
  for (double y : {0.5, 7.25, 20.0, 39.5}) {
    for (double x : {0.5, 1.0, 30.75, 59.5}) {
      const Eigen::Vector2d position = lens.At({x, y});
      EXPECT_NEAR(position.x(), F(x, y), 1e-9);
      EXPECT_NEAR(position.y(), G(x, y), 1e-9);
    }
  }
}

TEST(LensMap, RowsAreRoundedPositions) {
  for (int64_t columns : {4, 5, 23}) {
    const LensMap lens(Nodes(5, columns, 60, 40, F, G), 5, columns, 60, 40);
    std::vector<int32_t> x(60), y(60);
    for (int64_t row : {0, 1, 20, 39}) {
      lens.Row(row, 0, 60, x.data(), y.data());
      for (int64_t column = 0; column < 60; ++column) {
        const Eigen::Vector2d position = lens.At({column + 0.5, row + 0.5});
        EXPECT_NEAR(x[column], (position.x() - 0.5) * kSubPixels, 0.5001);
        EXPECT_NEAR(y[column], (position.y() - 0.5) * kSubPixels, 0.5001);
      }
    }
  }
}

TEST(LensMap, PartsOfARowArePartsOfTheWhole) {
  const LensMap lens(Nodes(5, 23, 60, 40, F, G), 5, 23, 60, 40);
  std::vector<int32_t> x(60), y(60), part_x(60), part_y(60);
  lens.Row(17, 0, 60, x.data(), y.data());
  for (int64_t first = 0; first < 60; ++first) {
    for (int64_t count = 1; count <= 60 - first; ++count) {
      lens.Row(17, first, count, part_x.data(), part_y.data());
      ASSERT_TRUE(std::equal(&part_x[0], &part_x[0] + count, &x[first])) << first << " " << count;
      ASSERT_TRUE(std::equal(&part_y[0], &part_y[0] + count, &y[first])) << first << " " << count;
    }
  }
}

TEST(LensMap, ImageSmallerThanItsLattice) {
  const LensMap lens(
      Nodes(
          4, 4, 2, 2, [](double x, double) { return x; }, [](double, double y) { return y; }),
      4, 4, 2, 2);
  std::vector<int32_t> x(2), y(2);
  lens.Row(1, 0, 2, x.data(), y.data());
  EXPECT_EQ(x, (std::vector<int32_t>{0, kSubPixels}));
  EXPECT_EQ(y, (std::vector<int32_t>{kSubPixels, kSubPixels}));
}

TEST(LensMap, FarPositionsDoNotOverflow) {
  const LensMap lens(Nodes(
                         4, 4, 9, 9, [](double x, double) { return (x - 4.5) * 1e12; },
                         [](double, double y) { return y; }),
                     4, 4, 9, 9);
  std::vector<int32_t> x(9), y(9);
  lens.Row(0, 0, 9, x.data(), y.data());
  EXPECT_LT(x[0], -(1 << 27));
  EXPECT_GT(x[8], 1 << 27);
}

TEST(LensMap, NodesThatAlternateDoNotOverflow) {
  // Signs of the four Lagrange polynomials between the first two nodes: at t = 3/8 their absolute
  // values add up to 827/512, near the 1.6312 that a cubic through bounded nodes can reach.
  const double signs[] = {1, 1, -1, 1};
  std::vector<double> nodes;
  for (double row : signs) {
    for (double column : signs) nodes.insert(nodes.end(), 2, row * column * 1e12);
  }
  const LensMap lens(nodes, 4, 4, 9, 9);
  constexpr double kExpected = 827.0 / 512 * 827 / 512 * kLargestSide;
  const Eigen::Vector2d position = lens.At({1.5, 1.5});
  EXPECT_NEAR(position.x(), kExpected, 1e-6);
  EXPECT_NEAR(position.y(), kExpected, 1e-6);
  std::vector<int32_t> x(9), y(9);
  lens.Row(1, 0, 9, x.data(), y.data());
  EXPECT_NEAR(x[1], (kExpected - 0.5) * kSubPixels, 0.51);
  EXPECT_NEAR(y[1], (kExpected - 0.5) * kSubPixels, 0.51);
}

TEST(LensMap, RefusesNodesThatAreNone) {
  std::vector<double> nodes(4 * 4 * 2, 1.0);
  EXPECT_THROW(LensMap(nodes, 4, 3, 9, 9), std::invalid_argument);
  nodes[5] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(LensMap(nodes, 4, 4, 9, 9), std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
