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
  // Around the centre of the cell that is the second to the east and the third to the north.
  std::vector<CloudPoint> points;
  for (const double shift : {-0.1, -0.05, 0.05, 0.1}) {
    points.push_back(Upward(1.5 + shift, 2.5 - shift, 7));
  }
  const std::vector<float> heights = Heights(points, {0, -4, 4, 4});
  for (size_t i = 0; i < 16; ++i) {
    if (i == 4 * 1 + 1) {
      EXPECT_EQ(heights[i], 7);
    } else {
      EXPECT_TRUE(std::isnan(heights[i]));
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

constexpr GapOptions Gap(double longest) { return {longest, 1, 0.5}; }

TEST(FillGaps, AGapIsFilledFromItsLowerSideUpToItsWidth) {
  // Ground, a gap of three cells, a roof.
  const int64_t size = 40;
  std::vector<float> heights(size_t(size * size), 0);
  for (size_t i = 0; i < heights.size(); ++i) {
    const size_t x = i % size_t(size);
    if (x >= 18) heights[i] = x < 21 ? kNone : 10;
  }
  const GapOptions narrow = Gap(2.9), wide = Gap(3);
  ASSERT_EQ(narrow.Margin(), 6);
  ASSERT_EQ(wide.Margin(), 6);
  const std::vector<float> open = FillGaps(heights.data(), size, size, narrow);
  const std::vector<float> filled = FillGaps(heights.data(), size, size, wide);
  ASSERT_EQ(filled.size(), 28u * 28u);
  for (size_t i = 0; i < filled.size(); ++i) {
    const size_t x = 6 + i % 28;
    EXPECT_EQ(std::isnan(open[i]), x >= 18 && x < 21);
    EXPECT_EQ(filled[i], x < 21 ? 0 : 10);
  }
}

TEST(FillGaps, OpenBordersStayOpen) {
  std::vector<float> heights(3600, kNone);
  for (size_t i = 0; i < 1800; ++i) heights[i] = 1;  // the northern half
  const std::vector<float> filled = FillGaps(heights.data(), 60, 60, Gap(10));
  for (size_t i = 0; i < 400; ++i) EXPECT_EQ(std::isnan(filled[i]), i >= 200);
}

}  // namespace
}  // namespace sirpy
