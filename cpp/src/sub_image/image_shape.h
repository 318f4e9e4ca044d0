// The shape of an 8-bit image: rows of `width` pixels, top to bottom, `channels` interleaved bytes
// each (1 grey, 3 RGB). Sizes are 64-bit: 150 megapixels by 3 channels do not fit 31 bits with room
// to spare.
#pragma once

#include <cstdint>

namespace sirpy {

struct ImageShape {
  int64_t width = 0;
  int64_t height = 0;
  int channels = 1;

  int64_t RowBytes() const { return width * channels; }
};

}  // namespace sirpy
