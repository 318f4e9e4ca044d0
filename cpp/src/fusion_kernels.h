// The inner loop of fusion: a run of neighbouring pixels of the reference asks one source after the
// other. Pixel centres are at whole numbers. Compiled once for each instruction set; the same bytes
// on every one.
#pragma once

#include <cstdint>

namespace sirpy::fusion {

constexpr int kRun = 64;  // pixels, at most

// The reference: p = (x, y, 1), K its intrinsics, all row-major.
struct Reference {
  double inverse_intrinsics[9];
  double focal_area;
};

// With the inverse depth r of a pixel of the reference, its pixel in the source is h = along * p +
// offset * r, homogeneous, and its depth there h.z / r.
struct Source {
  double along[9], offset[3];
  double centre[3];  // of projection, in the camera frame of the reference
  double back[3];    // its projection there, homogeneous
  double focal_area;
  bool comes_first;            // of views that are as sure, it emits the point
  const float* inverse_depth;  // of its window, row-major, 0 where there is none
  const float* deviation;      // its standard deviation; null: all are equally sure
  int64_t x0, y0, width, height;
};

struct Limits {
  double consistency, yield_shift, see_through;  // pixels, squared
  double agreement;                              // standard deviations, squared
  double yield_footprint;
};

// What is known of the pixels of a run; those without a depth have the inverse depth 0. In numbers
// of one size, so that all fill the same lanes.
struct Run {
  double first_x, y;
  int64_t count;
  double inverse_depth[kRun];
  double deviation[kRun];  // its standard deviation; 1 where all are equally sure
  double normal[3][kRun];  // camera frame
  double plane[2][kRun];   // slopes of inverse depth
  double towards[kRun];    // normal . point
  double footprint[kRun];  // area of the surface that the pixel covers
  // What the sources have said so far.
  double num_seeing[kRun], num_consistent[kRun], num_through[kRun];
  double num_close[kRun];  // of the consistent ones, within `consistency`
  double sum_inverse_depth[kRun], sum_weight[kRun];
  double has_better[kRun];  // 1: a view that may emit the point knows it well enough
};

struct Kernels {
  void (*invert)(const float* depth, int64_t count, float* inverse_depth);  // 0 of what is none
  // Standard deviations of inverse depths from those of depths.
  void (*deviations)(const float* sigma, const float* inverse_depth, int64_t count,
                     float* deviation);
  // Fills plane, towards and footprint from inverse depth and normal, and begins the counts.
  void (*begin)(const Reference&, Run*);
  void (*ask)(const Source&, const Limits&, Run*);
};

}  // namespace sirpy::fusion
