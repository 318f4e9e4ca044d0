// Heights of the ground as seen from above (a digital surface model), of points on a lattice.
//
// Geometry: x east, y north, z up, one unit. Cell (column, row) of the lattice has its centre at
// ((column + 0.5) * cell, -(row + 0.5) * cell): rows go south, and every raster of the same cell
// size shares the lattice. The height of a cell depends on the points in some cells around it and
// on their order alone, not on the window that is asked for.
//
// A cell has the height of the uppermost layer of points around its centre that is no stray: it
// has at least `share` of the ground that the strongest layer there has, a point near the centre,
// and enough points in the neighbourhood. Points are carried to the centre along their own tangent
// planes, so that a layer is thin on a slope too; those of a wall count little. Nothing is
// interpolated between a roof and the ground.
#pragma once

#include <cstdint>
#include <vector>

namespace sirpy {

// A point of the fused cloud, as sirpy.cloud.POINT.
struct CloudPoint {
  double x, y, z;
  float nx, ny, nz;  // unit
  uint8_t red, green, blue;
  uint8_t views;
  float confidence;
  float gsd;
  float sigma;  // standard deviation along the ray; 0: not known
  int32_t level;
};
static_assert(sizeof(CloudPoint) == 56, "the points of numpy are not padded");

struct CellWindow {
  int64_t column = 0;  // of the first cell, on the lattice
  int64_t row = 0;
  int64_t width = 0;  // cells
  int64_t height = 0;
};

struct SurfaceOptions {
  double cell = 1;       // side, units
  double reach = 1;      // units: points within it of a centre give the height, coarse ones farther
  double thickness = 4;  // units: of a layer
  double share = 0.4;    // of the strongest layer's weight, that makes a layer
  double near = 0.75;    // reaches: a layer has a point that close to the centre
  int support = 4;  // points that a layer has at least within two reaches, at most three of these

  // Throws std::invalid_argument that names field, value and bound.
  void Validate() const;

  // Cells around a window whose points count in it.
  int64_t Margin() const;
};

// Heights of a window, row-major; NaN where there is none. `points`: all that lie in the window or
// within its margin, in an order that does not depend on the window; others do no harm.
std::vector<float> SurfaceHeights(const CloudPoint* points, int64_t count, const CellWindow& window,
                                  const SurfaceOptions& options);

struct GapOptions {
  double longest = 1;  // cells: gaps that are wider stay
  double cell = 1;     // side, units
  double step = 1;     // units: what may lie between the heights of one layer

  // Cells around a window whose heights count in it.
  int64_t Margin() const;
};

// The heights of a window, row-major, of those of the window and its margin (width x height in
// all). A cell without a height gets one where it lies in a gap of at most the longest width along
// one of eight axes, from the lower side of the gap: what is hidden beside a building is ground. Of
// what is seen first in 16 directions, within two such widths, the lowest layer that is seen in
// enough of them counts, by inverse square distance; a layer may rise by half the distance.
std::vector<float> FillGaps(const float* heights, int64_t width, int64_t height,
                            const GapOptions& options);

}  // namespace sirpy
