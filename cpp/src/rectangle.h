// A rectangle of whole pixels of an image: pixel (x, y) is inside when x0 <= x < x0 + width, and
// the same in y. x to the right, y down, (0, 0) is the top-left pixel. Coordinates are signed; a
// rectangle may reach beyond the image.
#pragma once

#include <cstdint>

namespace sirpy {

struct Rectangle {
  int64_t x0 = 0;
  int64_t y0 = 0;
  int64_t width = 0;
  int64_t height = 0;

  int64_t x1() const { return x0 + width; }
  int64_t y1() const { return y0 + height; }
  int64_t Area() const { return width * height; }
};

}  // namespace sirpy
