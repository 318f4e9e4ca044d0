// The shape of an image in memory: rows of `width` pixels, top to bottom, `channels` interleaved
// samples each (1 grey, 3 RGB, more with alpha or infrared), of one byte or of two (native byte
// order). Sizes are 64-bit: 150 megapixels by 3 channels do not fit 31 bits with room to spare.
#pragma once

#include <cstdint>

namespace sirpy {

struct ImageShape {
  int64_t width = 0;
  int64_t height = 0;
  int channels = 1;
  int sample_bytes = 1;

  int64_t PixelBytes() const { return int64_t{channels} * sample_bytes; }
  int64_t RowBytes() const { return width * PixelBytes(); }

  bool operator==(const ImageShape& other) const {
    return width == other.width && height == other.height && channels == other.channels &&
           sample_bytes == other.sample_bytes;
  }
};

}  // namespace sirpy
