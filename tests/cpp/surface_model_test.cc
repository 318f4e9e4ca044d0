#include "surface_model.h"

#include <cmath>
#include <limits>
#include <stdexcept>

#include <gtest/gtest.h>

namespace sirpy {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

CloudPoint Upward(double x, double y, double z) { return {x, y, z, 0, 0, 1, 0, 0, 0, 3, 0.8f, 1}; }

// Four points in each cell of a square, cells of 1.
std::vector<CloudPoint> Level(double x0, double y0, int side, double z) {
  std::vector<CloudPoint> points;
  for (int i = 0; i < 4 * side * side; ++i) {
    points.push_back(
        Upward(x0 + 0.25 + 0.5 * (i % (2 * side)), y0 + 0.25 + 0.5 * (i / (2 * side)), z));
  }
  return points;
}

std::vector<float> Heights(const std::vector<CloudPoint>& points, const CellWindow& window) {
  return SurfaceHeights(points.data(), int64_t(points.size()), window, SurfaceOptions());
}

TEST(SurfaceModel, RowsGoSouthAndCellsWithoutPointsHaveNoHeight) {
  // One cell east, two cells north of the origin.
  const std::vector<float> heights = Heights(Level(1, 2, 1, 7), {0, -4, 4, 4});
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const float height = heights[size_t(4 * row + column)];
      if (row == 1 && column == 1) {
        EXPECT_EQ(height, 7);
      } else {
        EXPECT_TRUE(std::isnan(height));
      }
    }
  }
}

TEST(SurfaceModel, TheUppermostLayerThatIsNoStrayCounts) {
  std::vector<CloudPoint> points = Level(-5, -5, 10, 0);
  for (const CloudPoint& point : Level(-5, -5, 10, 20)) points.push_back(point);
  EXPECT_EQ(Heights(points, {0, 0, 1, 1})[0], 20);
  points.push_back(Upward(0.5, -0.5, 50));
  EXPECT_EQ(Heights(points, {0, 0, 1, 1})[0], 20);
}

TEST(SurfaceModel, AWindowDoesNotChangeAHeight) {
  std::vector<CloudPoint> points;
  for (int i = 0; i < 4000; ++i) {
    const double angle = 2.399963 * i, radius = 0.3 * std::sqrt(double(i));
    points.push_back(Upward(radius * std::cos(angle), radius * std::sin(angle),
                            3 * std::sin(0.7 * radius) + (i % 7 == 0 ? 9 : 0)));
    points.back().gsd = i % 3 == 0 ? 1.9f : 0.8f;
  }
  const std::vector<float> all = Heights(points, {-12, -12, 24, 24});
  for (int row = 0; row < 24; row += 5) {
    for (int column = 0; column < 24; ++column) {
      const float single = Heights(points, {column - 12, row - 12, 1, 1})[0];
      const float height = all[size_t(24 * row + column)];
      EXPECT_TRUE(single == height || (std::isnan(single) && std::isnan(height)));
    }
  }
}

TEST(SurfaceModel, PointsThatAreNotNumbersAreNotSeen) {
  std::vector<CloudPoint> points = Level(-3, -3, 6, 1);
  points.push_back(Upward(0.5, -0.5, kNone));
  points.push_back(Upward(kNone, -0.5, 4));
  points.push_back(Upward(0.5, -std::numeric_limits<double>::infinity(), 4));
  EXPECT_EQ(Heights(points, {0, 0, 1, 1})[0], 1);
}

TEST(SurfaceModel, OptionsOutOfBoundsAreNamed) {
  SurfaceOptions options;
  options.share = 1.5;
  EXPECT_THROW(options.Validate(), std::invalid_argument);
  options = {};
  options.cell = 0;
  EXPECT_THROW(options.Validate(), std::invalid_argument);
}

TEST(FillGaps, AGapIsFilledFromItsLowerSideUpToItsWidth) {
  // Ground, a gap of three cells, a roof.
  const int width = 9, height = 5;
  std::vector<float> heights(size_t(width * height), 0);
  for (int i = 0; i < width * height; ++i) {
    if (i % width >= 3) heights[size_t(i)] = i % width < 6 ? kNone : 10;
  }
  const std::vector<float> narrow = FillGaps(heights.data(), width, height, 2.9, 1, 0.5);
  EXPECT_TRUE(std::isnan(narrow[size_t(2 * width + 4)]));
  const std::vector<float> filled = FillGaps(heights.data(), width, height, 3, 1, 0.5);
  for (int i = 0; i < width * height; ++i) {
    EXPECT_EQ(filled[size_t(i)], i % width < 6 ? 0 : 10);
  }
}

TEST(FillGaps, OpenBordersStayOpen) {
  std::vector<float> heights(100, kNone);
  for (int i = 0; i < 50; ++i) heights[size_t(i)] = 1;  // the northern half
  const std::vector<float> filled = FillGaps(heights.data(), 10, 10, 20, 1, 0.5);
  for (int i = 50; i < 100; ++i) EXPECT_TRUE(std::isnan(filled[size_t(i)]));
}

}  // namespace
}  // namespace sirpy
