// Reading a rectangle of a sub-image file (JPEG or PNG by its extension) without holding the rest
// of it.
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

// The pixels of `window`, in pixels of the file, row-major. Throws InputError when the file is
// damaged or smaller than the window.
std::vector<uint8_t> ReadGrey(const std::filesystem::path& path, const Rectangle& window);

// The same as RGB; a grey file gives equal channels.
std::vector<uint8_t> ReadColor(const std::filesystem::path& path, const Rectangle& window);

}  // namespace sirpy
