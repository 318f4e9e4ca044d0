// A sink that keeps the rows that it is given, and pixels to push.
#pragma once

#include <algorithm>
#include <cstdint>
#include <random>
#include <utility>
#include <vector>

#include "sub_image/image_shape.h"
#include "sub_image/row_sink.h"

namespace sirpy {

class Collect : public RowSink {
 public:
  Collect(const ImageShape& shape, std::vector<uint8_t>* pixels)
      : row_bytes_(shape.RowBytes()), pixels_(pixels) {}
  void Push(const uint8_t* rows, int64_t count) override {
    pixels_->insert(pixels_->end(), rows, rows + count * row_bytes_);
  }
  void Finish() override {}
  bool Done() const override { return false; }

 private:
  int64_t row_bytes_;
  std::vector<uint8_t>* pixels_;
};

inline std::vector<uint8_t> Noise(const ImageShape& shape) {
  std::mt19937 random(7);
  std::vector<uint8_t> pixels(shape.RowBytes() * shape.height);
  for (uint8_t& byte : pixels) byte = static_cast<uint8_t>(random());
  return pixels;
}

// Pushes `pixels` in blocks of `block` rows.
inline void PushAll(RowSink& sink, const ImageShape& shape, const std::vector<uint8_t>& pixels,
                    int64_t block) {
  for (int64_t row = 0; row < shape.height; row += block) {
    sink.Push(&pixels[row * shape.RowBytes()], std::min(block, shape.height - row));
  }
  sink.Finish();
}

}  // namespace sirpy
