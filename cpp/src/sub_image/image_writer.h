// Writing an 8-bit image row by row, as JPEG or PNG by the extension of its name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_shape.h"

namespace sirpy {

class ImageWriter {
 public:
  virtual ~ImageWriter() = default;

  // The next row, top to bottom: width x channels bytes. Throws OutputError.
  virtual void WriteRow(const uint8_t* row) = 0;

  // After the last row: the file takes its name, under which it is always whole. Throws
  // OutputError.
  virtual void Finish() = 0;
};

struct WriterOptions {
  int jpeg_quality = 95;  // 1 .. 100, as libjpeg has it

  // Throws std::invalid_argument.
  void Validate() const;
};

// `path` ends in .jpg, .jpeg or .png. Throws OutputError when it cannot be opened.
std::unique_ptr<ImageWriter> OpenImageWriter(const std::filesystem::path& path,
                                             const ImageShape& shape, const WriterOptions& options);

}  // namespace sirpy
