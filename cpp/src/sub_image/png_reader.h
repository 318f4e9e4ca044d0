// Reading a PNG row by row: 8-bit grey or RGB, not interlaced, as PngWriter makes them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_shape.h"

namespace sirpy {

class PngReader {
 public:
  // Reads the header. Throws InputError when the file is missing or is not such a PNG.
  explicit PngReader(const std::filesystem::path& path);
  ~PngReader();

  const ImageShape& shape() const { return shape_; }

  // The next `count` rows, contiguous. Throws InputError when the data is damaged or ends early.
  void ReadRows(int64_t count, uint8_t* rows);

  // Passes over `count` rows.
  void SkipRows(int64_t count);

 private:
  struct Decoder;
  std::unique_ptr<Decoder> decoder_;
  ImageShape shape_;
};

}  // namespace sirpy
