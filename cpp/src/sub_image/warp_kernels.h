// The inner loops of the warp, over the pixels of a target row. Compiled once for each instruction
// set; all of them give the same bytes.
#pragma once

#include <cstdint>

namespace sirpy::warp {

// Rows of the photograph in a ring: row r is in slot r & slot_mask. `kRingPadding` bytes after the
// last slot may be read.
constexpr int kRingPadding = 8;

struct SourceRows {
  const uint8_t* slots;
  int64_t slot_mask;
  int64_t row_bytes;
  int32_t width;  // of the photograph, pixels
  int32_t height;
};

// Samples of `count` pixels of a photograph at positions (x, y) in sub-pixels (sub_pixels.h) into
// `out`, pixels of the photograph's kind with `channels` samples.
using SampleRow = void (*)(const SourceRows& source, int channels, const int32_t* x,
                           const int32_t* y, int64_t count, uint8_t* out);

struct Kernels {
  // Positions of `count` pixels from first_column on: the cubics c[0] + c[1] t + c[2] t^2 + c[3]
  // t^3 (pixels) at t = column * nodes_per_pixel - first_node, in sub-pixels.
  void (*positions)(const double* cubic_x, const double* cubic_y, int64_t first_column,
                    double nodes_per_pixel, double first_node, int64_t count, int32_t* x,
                    int32_t* y);

  // Bilinear, of 8-bit photographs with one and with three channels, rounded to nearest; black
  // beyond the outermost pixel centres.
  SampleRow bilinear_grey8;
  SampleRow bilinear_rgb8;
};

const Kernels& BestKernels();

}  // namespace sirpy::warp
