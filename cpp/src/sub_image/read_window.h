// Reading a rectangle of a sub-image file (JPEG or PNG) without holding the rest of it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "rectangle.h"
#include "sub_image/image_shape.h"

namespace sirpy {

// Luma in whole numbers (ITU-R BT.601), so that every reader gives the same grey for the same
// colour.
inline uint8_t Luma(uint8_t red, uint8_t green, uint8_t blue) {
  return static_cast<uint8_t>((4899 * red + 9617 * green + 1868 * blue + 8192) >> 14);
}

enum class Pixels {
  kGrey,   // 8 bit, luma of RGB
  kColor,  // 8 bit, RGB; grey gives equal channels
  kAll,    // as stored: every channel, 8 or 16 bit
};

struct WindowPixels {
  ImageShape shape;
  std::vector<uint8_t> bytes;
};

// `count` pixels of `shape` as `pixels` asks for. 16-bit samples become 8 bit so that `white` and
// what is above it is 255.
void ConvertPixels(const uint8_t* stored, const ImageShape& shape, int64_t count, Pixels pixels,
                   int white, uint8_t* converted);

// The shape of `window` of an image of shape `stored`, when it is read as `pixels`.
ImageShape ConvertedShape(const ImageShape& stored, const Rectangle& window, Pixels pixels);

// The pixels of `window`, in pixels of the file, row-major. Throws InputError when the file is
// damaged or smaller than the window.
WindowPixels ReadWindow(const std::filesystem::path& path, const Rectangle& window, Pixels pixels,
                        int white);

}  // namespace sirpy
