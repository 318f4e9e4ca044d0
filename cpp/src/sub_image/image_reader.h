// Reading an image row by row, as it is stored: an EXIF orientation is not applied, since cameras
// are solved without it. The format is told by the content, not by the name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <vector>

#include "sub_image/image_shape.h"

namespace sirpy {

enum class Bands {
  kColor,  // grey or RGB; alpha is passed over
  kAll,
};

class ImageReader {
 public:
  virtual ~ImageReader() = default;

  const ImageShape& shape() const { return shape_; }
  bool has_alpha() const { return has_alpha_; }

  // What the decoder holds of the whole image, in bytes for each pixel: 0 when rows stream.
  double held_bytes_per_pixel() const { return held_bytes_per_pixel_; }

  // The next `count` rows, contiguous. Throws InputError when the data is damaged or ends early.
  virtual void ReadRows(int64_t count, uint8_t* rows) = 0;

  // Passes over `count` rows.
  virtual void SkipRows(int64_t count);

  // After the last row: throws InputError when the end of the file is damaged.
  virtual void Finish() = 0;

 protected:
  // Throws InputError when the file has fewer than `bytes`: a header may claim any size, and
  // buffers follow it.
  static void CheckFileHolds(const std::filesystem::path& path, int64_t bytes);

  ImageShape shape_;
  bool has_alpha_ = false;
  double held_bytes_per_pixel_ = 0;
};

// Reads the header of a JPEG or PNG. Throws InputError when it is missing, damaged or neither.
std::unique_ptr<ImageReader> OpenImageReader(const std::filesystem::path& path, Bands bands);

// How often each value of 0 .. 65535 occurs among the samples of a whole image.
std::vector<int64_t> CountSamples(ImageReader& image);

}  // namespace sirpy
