#include "sub_image/read_window.h"

#include <string>

#include "error.h"
#include "sub_image/jpeg_reader.h"
#include "sub_image/png_reader.h"

namespace sirpy {
namespace {

// Calls use(row, pixels, channels) with the window's part of each of its rows.
template <typename Reader, typename Use>
void ForRows(const std::filesystem::path& path, const Rectangle& window, Use use) {
  Reader reader(path);
  const ImageShape& shape = reader.shape();
  if (window.x0 < 0 || window.y0 < 0 || window.x1() > shape.width || window.y1() > shape.height) {
    throw InputError("image " + path.string() + " has " + std::to_string(shape.width) + "x" +
                     std::to_string(shape.height) +
                     " pixels, less than its workspace says: delete it and cut again");
  }
  std::vector<uint8_t> row(shape.RowBytes());
  reader.SkipRows(window.y0);
  for (int64_t y = 0; y < window.height; ++y) {
    reader.ReadRows(1, row.data());
    use(y, row.data() + window.x0 * shape.channels, shape.channels);
  }
}

template <typename Use>
void ForRowsOfFile(const std::filesystem::path& path, const Rectangle& window, Use use) {
  if (path.extension() == ".png") {
    ForRows<PngReader>(path, window, use);
  } else {
    ForRows<JpegReader>(path, window, use);
  }
}

}  // namespace

std::vector<uint8_t> ReadGrey(const std::filesystem::path& path, const Rectangle& window) {
  std::vector<uint8_t> grey(window.Area());
  ForRowsOfFile(path, window, [&](int64_t y, const uint8_t* pixels, int channels) {
    uint8_t* out = &grey[y * window.width];
    for (int64_t x = 0; x < window.width; ++x, pixels += channels) {
      out[x] = channels == 1 ? pixels[0] : Luma(pixels[0], pixels[1], pixels[2]);
    }
  });
  return grey;
}

std::vector<uint8_t> ReadColor(const std::filesystem::path& path, const Rectangle& window) {
  std::vector<uint8_t> color(window.Area() * 3);
  ForRowsOfFile(path, window, [&](int64_t y, const uint8_t* pixels, int channels) {
    uint8_t* out = &color[y * window.width * 3];
    for (int64_t x = 0; x < window.width; ++x, pixels += channels, out += 3) {
      for (int c = 0; c < 3; ++c) out[c] = pixels[channels == 1 ? 0 : c];
    }
  });
  return color;
}

}  // namespace sirpy
