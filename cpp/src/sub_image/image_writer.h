// Writing an image row by row, as JPEG, PNG or TIFF by the extension of its name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_shape.h"

namespace sirpy {

class ImageWriter {
 public:
  virtual ~ImageWriter() = default;

  // The next row, top to bottom, in native byte order. Throws OutputError.
  virtual void WriteRow(const uint8_t* row) = 0;

  // After the last row: the file takes its name, under which it is always whole. Throws
  // OutputError.
  virtual void Finish() = 0;
};

// Colour of a JPEG at full resolution (4:4:4), half the columns, or half of columns and rows.
enum class JpegChroma { k444, k422, k420 };

struct WriterOptions {
  int jpeg_quality = 95;  // 1 .. 100, as libjpeg has it
  JpegChroma jpeg_chroma = JpegChroma::k444;
  bool last_is_alpha = false;  // of the channels; a TIFF says so

  // Throws std::invalid_argument.
  void Validate() const;
};

constexpr int64_t kLongestJpegSide = 65500;     // pixels; of the format, less what libjpeg keeps
constexpr int64_t kLongestPngSide = 1'000'000;  // libpng's bound

// `path` ends in .jpg or .jpeg (8 bit, 1 or 3 channels), .png (8 or 16 bit, up to 4 channels) or
// .tif (8 or 16 bit, any number of channels). Throws std::invalid_argument for anything else,
// InputError when a side is too long for the format, OutputError when the file cannot be opened.
std::unique_ptr<ImageWriter> OpenImageWriter(const std::filesystem::path& path,
                                             const ImageShape& shape, const WriterOptions& options);

}  // namespace sirpy
