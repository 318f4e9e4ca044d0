#include "sub_image/image_writer.h"

#include <algorithm>
#include <stdexcept>
#include <string>

#include "error.h"
#include "sub_image/jpeg_writer.h"
#include "sub_image/png_writer.h"
#include "sub_image/tiff_writer.h"

namespace sirpy {
namespace {

void CheckSide(const std::filesystem::path& path, int64_t side, int64_t longest) {
  if (side > longest) {
    throw InputError("sub-image " + path.string() + " would have a side of " +
                     std::to_string(side) + " pixels, and its format holds " +
                     std::to_string(longest) + ": cut it into more sub-images, or into TIFF");
  }
}

}  // namespace

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
  const int64_t longest = std::max(shape.width, shape.height);
  if (extension == ".jpg" || extension == ".jpeg") {
    CheckSide(path, longest, kLongestJpegSide);
    if (shape.sample_bytes == 1 && (shape.channels == 1 || shape.channels == 3)) {
      return std::make_unique<JpegWriter>(path, shape, options);
    }
  } else if (extension == ".png") {
    CheckSide(path, longest, kLongestPngSide);
    if (shape.channels <= 4) return std::make_unique<PngWriter>(path, shape);
  } else if (extension == ".tif") {
    return std::make_unique<TiffWriter>(path, shape, options);
  }
  throw std::invalid_argument(path.string() + " cannot hold " + std::to_string(shape.channels) +
                              " channels of " + std::to_string(8 * shape.sample_bytes) + " bits");
}

}  // namespace sirpy
