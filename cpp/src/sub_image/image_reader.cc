#include "sub_image/image_reader.h"

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "error.h"
#include "sub_image/jpeg_reader.h"
#include "sub_image/png_reader.h"

namespace sirpy {

void ImageReader::SkipRows(int64_t count) {
  std::vector<uint8_t> row(shape_.RowBytes());
  for (; count > 0; --count) ReadRows(1, row.data());
}

void ImageReader::CheckFileHolds(const std::filesystem::path& path, int64_t bytes) {
  std::error_code error;
  const uintmax_t size = std::filesystem::file_size(path, error);
  if (!error && size < static_cast<uintmax_t>(bytes)) {
    throw InputError("photograph " + path.string() +
                     " is damaged (it is too short for its size in pixels): replace it by a good "
                     "copy, or take it out of the folder");
  }
}

std::unique_ptr<ImageReader> OpenImageReader(const std::filesystem::path& path, Bands bands) {
  std::array<unsigned char, 4> start = {};
  {
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> file(std::fopen(path.c_str(), "rb"),
                                                               &std::fclose);
    if (file == nullptr) {
      throw InputError("cannot open image " + path.string() + ": " + std::strerror(errno));
    }
    const size_t read = std::fread(start.data(), 1, start.size(), file.get());
    static_cast<void>(read);  // what is missing is zero, and no format
  }
  if (std::memcmp(start.data(), "\xff\xd8\xff", 3) == 0) return std::make_unique<JpegReader>(path);
  if (std::memcmp(start.data(), "\x89PNG", 4) == 0) return std::make_unique<PngReader>(path, bands);
  throw InputError("image " + path.string() +
                   " is neither JPEG nor PNG: replace it by a good copy, or take it out of the "
                   "folder");
}

std::vector<int64_t> CountSamples(ImageReader& image) {
  const ImageShape& shape = image.shape();
  std::vector<int64_t> count(1 << 16);
  std::vector<uint8_t> row(shape.RowBytes());
  for (int64_t y = 0; y < shape.height; ++y) {
    image.ReadRows(1, row.data());
    for (int64_t i = 0; i < shape.width * shape.channels; ++i) {
      uint16_t sample = row[i * shape.sample_bytes];
      if (shape.sample_bytes == 2) std::memcpy(&sample, &row[2 * i], sizeof sample);
      ++count[sample];
    }
  }
  image.Finish();
  return count;
}

}  // namespace sirpy
