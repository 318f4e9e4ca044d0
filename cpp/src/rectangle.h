// A rectangle of whole pixels of an image: pixel (x, y) is inside when x0 <= x < x0 + width, and
// the same in y. x to the right, y down, (0, 0) is the top-left pixel. Coordinates are signed; a
// rectangle may reach beyond the image.
#pragma once

#include <algorithm>
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

  bool Contains(const Rectangle& other) const {
    return x0 <= other.x0 && y0 <= other.y0 && other.x1() <= x1() && other.y1() <= y1();
  }
};

// The smallest rectangle that holds both.
inline Rectangle Union(const Rectangle& a, const Rectangle& b) {
  const int64_t x0 = std::min(a.x0, b.x0);
  const int64_t y0 = std::min(a.y0, b.y0);
  return {x0, y0, std::max(a.x1(), b.x1()) - x0, std::max(a.y1(), b.y1()) - y0};
}

}  // namespace sirpy
