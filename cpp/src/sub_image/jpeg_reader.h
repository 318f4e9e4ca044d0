// Reading a JPEG row by row through libjpeg-turbo: 8-bit grey or RGB, as stored (an EXIF
// orientation is not applied, since cameras are solved without it). A progressive JPEG works, but
// libjpeg then holds all of its coefficients.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_shape.h"

namespace sirpy {

class JpegReader {
 public:
  // Reads the header. Throws InputError when the file is missing, is no JPEG, or is CMYK.
  explicit JpegReader(const std::filesystem::path& path);
  ~JpegReader();

  const ImageShape& shape() const { return shape_; }

  // The next `count` rows, contiguous. Throws InputError when the data is damaged or ends early.
  void ReadRows(int64_t count, uint8_t* rows);

  // Passes over `count` rows.
  void SkipRows(int64_t count);

  // After the last row: throws InputError when the end of the file is damaged.
  void Finish();

 private:
  void StartIfNeeded();

  struct Decoder;
  std::unique_ptr<Decoder> decoder_;
  ImageShape shape_;
};

}  // namespace sirpy
