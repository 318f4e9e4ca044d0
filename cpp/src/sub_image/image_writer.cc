#include "sub_image/image_writer.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "sub_image/jpeg_writer.h"
#include "sub_image/png_writer.h"
#include "sub_image/tiff_writer.h"

namespace sirpy {

void WriterOptions::Validate() const {
  if (jpeg_quality < 1 || jpeg_quality > 100) {
    throw std::invalid_argument("jpeg_quality = " + std::to_string(jpeg_quality) +
                                ": it must be between 1 and 100");
  }
}

std::unique_ptr<ImageWriter> OpenImageWriter(const std::filesystem::path& path,
                                             const ImageShape& shape,
                                             const WriterOptions& options) {
  options.Validate();
  const std::string extension = path.extension().string();
  if (extension == ".jpg" || extension == ".jpeg") {
    const bool fits = std::max(shape.width, shape.height) <= kLongestJpegSide;
    if (fits && shape.sample_bytes == 1 && (shape.channels == 1 || shape.channels == 3)) {
      return std::make_unique<JpegWriter>(path, shape, options);
    }
  } else if (extension == ".png") {
    const bool fits = std::max(shape.width, shape.height) <= kLongestPngSide;
    if (fits && shape.channels <= 4) return std::make_unique<PngWriter>(path, shape);
  } else if (extension == ".tif") {
    return std::make_unique<TiffWriter>(path, shape, options);
  }
  throw std::invalid_argument(path.string() + " cannot hold " + std::to_string(shape.width) + "x" +
                              std::to_string(shape.height) + " pixels of " +
                              std::to_string(shape.channels) + " channels of " +
                              std::to_string(8 * shape.sample_bytes) + " bits");
}

}  // namespace sirpy
