// Small squares recaptured from a photograph while its rows go by, once: memory is that of the
// squares, whatever the size of the photograph.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "sub_image/image_reader.h"
#include "sub_image/image_shape.h"

namespace sirpy {

class PatchCutter {
 public:
  // `origins` are the top-left pixels of squares of `side` pixels. Throws std::invalid_argument
  // where one reaches beyond the photograph.
  PatchCutter(const ImageShape& photograph, std::vector<std::array<int64_t, 2>> origins, int side);

  const ImageShape& photograph() const { return photograph_; }
  // Rows outside of [first_row, end_row) are not needed.
  int64_t first_row() const { return first_row_; }
  int64_t end_row() const { return end_row_; }
  bool Done() const { return next_row_ >= end_row_; }

  // The next rows, contiguous, from first_row on.
  void Push(const uint8_t* rows, int64_t count);

  // Luma (ITU-R BT.601) in 16 bits, square after square, row-major: 8-bit samples times 256, so
  // that what the weights leave behind the point is kept. Once, after the last row.
  std::vector<uint16_t> TakePatches();

 private:
  void CutRow(const uint8_t* row, int64_t y);

  ImageShape photograph_;
  std::vector<std::array<int64_t, 2>> origins_;
  std::vector<size_t> by_row_;  // squares in the order of their first rows
  std::vector<size_t> open_;    // those that the next row goes through
  size_t begun_ = 0;            // of by_row_
  int side_;
  int64_t first_row_ = 0;
  int64_t end_row_ = 0;
  int64_t next_row_ = 0;
  std::vector<uint16_t> patches_;
};

// Reads from the photograph what the cutter needs, to its last row, so that damage shows. Throws
// InputError when it is damaged or has another shape than the cutter was told.
void CutPatches(ImageReader& photograph, PatchCutter& cutter);

}  // namespace sirpy
