#include "sub_image/read_window.h"

#include <algorithm>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <string>

#include "error.h"
#include "sub_image/image_reader.h"

namespace sirpy {
namespace {

inline uint8_t ToByte(uint8_t sample, int /*white*/) { return sample; }

inline uint8_t ToByte(uint16_t sample, int white) {
  return static_cast<uint8_t>((std::min<int>(sample, white) * 255 + white / 2) / white);
}

template <typename Sample>
void Convert(const Sample* stored, int channels, int64_t count, bool color, int white,
             uint8_t* out) {
  for (int64_t i = 0; i < count; ++i, stored += channels) {
    const uint8_t red = ToByte(stored[0], white);
    const uint8_t green = channels >= 3 ? ToByte(stored[1], white) : red;
    const uint8_t blue = channels >= 3 ? ToByte(stored[2], white) : red;
    if (color) {
      *out++ = red;
      *out++ = green;
      *out++ = blue;
    } else {
      *out++ = channels >= 3 ? Luma(red, green, blue) : red;
    }
  }
}

}  // namespace

void ConvertPixels(const uint8_t* stored, const ImageShape& shape, int64_t count, Pixels pixels,
                   int white, uint8_t* converted) {
  if (white < 1 || white > 65535) throw std::invalid_argument("white must be 1 to 65535");
  const bool color = pixels == Pixels::kColor;
  if (pixels == Pixels::kAll) {
    std::memcpy(converted, stored, count * shape.PixelBytes());
  } else if (shape.sample_bytes == 1) {
    Convert(stored, shape.channels, count, color, white, converted);
  } else {
    Convert(reinterpret_cast<const uint16_t*>(stored), shape.channels, count, color, white,
            converted);
  }
}

ImageShape ConvertedShape(const ImageShape& stored, const Rectangle& window, Pixels pixels) {
  if (pixels == Pixels::kAll) {
    return {window.width, window.height, stored.channels, stored.sample_bytes};
  }
  return {window.width, window.height, pixels == Pixels::kColor ? 3 : 1, 1};
}

WindowPixels ReadWindow(const std::filesystem::path& path, const Rectangle& window, Pixels pixels,
                        int white) {
  const std::unique_ptr<ImageReader> reader =
      OpenImageReader(path, pixels == Pixels::kAll ? Bands::kAll : Bands::kColor);
  const ImageShape& stored = reader->shape();
  if (!Rectangle{0, 0, stored.width, stored.height}.Contains(window)) {
    throw InputError("image " + path.string() + " has " + std::to_string(stored.width) + "x" +
                     std::to_string(stored.height) +
                     " pixels, less than its workspace says: delete it and cut again");
  }
  WindowPixels read{ConvertedShape(stored, window, pixels), {}};
  read.bytes.resize(read.shape.RowBytes() * read.shape.height);
  std::vector<uint8_t> row(stored.RowBytes());
  reader->SkipRows(window.y0);
  for (int64_t y = 0; y < window.height; ++y) {
    reader->ReadRows(1, row.data());
    ConvertPixels(row.data() + window.x0 * stored.PixelBytes(), stored, window.width, pixels, white,
                  &read.bytes[y * read.shape.RowBytes()]);
  }
  return read;
}

}  // namespace sirpy
