// Reading a PNG row by row as 8-bit grey or RGB: a palette is looked up, an alpha channel passed
// over. Not interlaced, since the rows of such a file are only known at its end.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_shape.h"

namespace sirpy {

class PngReader {
 public:
  // Reads the header. Throws InputError when the file is missing or no such PNG (16-bit,
  // interlaced).
  explicit PngReader(const std::filesystem::path& path);
  ~PngReader();

  const ImageShape& shape() const { return shape_; }

  // The next `count` rows, contiguous. Throws InputError when the data is damaged or ends early.
  void ReadRows(int64_t count, uint8_t* rows);

  // Passes over `count` rows.
  void SkipRows(int64_t count);

  // After the last row: throws InputError when the end of the file is damaged.
  void Finish();

  bool has_alpha() const { return has_alpha_; }

 private:
  struct Decoder;
  std::unique_ptr<Decoder> decoder_;
  ImageShape shape_;
  bool has_alpha_ = false;
};

}  // namespace sirpy
