#include "patch_match/pyramid.h"

#include <algorithm>

namespace sirpy::patch_match {
std::vector<uint8_t> Shrunk(const uint8_t* grey, int width, int height, int factor) {
  const int columns = (width + factor - 1) / factor, rows = (height + factor - 1) / factor;
  std::vector<uint8_t> shrunk(size_t(columns) * rows);
  std::vector<uint32_t> sums(columns);
  for (int row = 0; row < rows; ++row) {
    std::fill(sums.begin(), sums.end(), 0);
    const int first = row * factor, end = std::min(first + factor, height);
    for (int y = first; y < end; ++y) {
      const uint8_t* from = grey + int64_t(y) * width;
      for (int column = 0; column < columns; ++column) {
        const int right = std::min((column + 1) * factor, width);
        for (int x = column * factor; x < right; ++x) sums[column] += from[x];
      }
    }
    for (int column = 0; column < columns; ++column) {
      const int across = std::min(factor, width - column * factor);
      const uint32_t count = uint32_t(across) * uint32_t(end - first);
      shrunk[size_t(row) * columns + column] = uint8_t((sums[column] + count / 2) / count);
    }
  }
  return shrunk;
}

void PackQuads(const uint8_t* grey, int width, int height, uint32_t* quads) {
  for (int y = 0; y < height; ++y) {
    const uint8_t* upper = grey + int64_t(y) * width;
    const uint8_t* lower = y + 1 < height ? upper + width : upper;
    for (int x = 0; x < width; ++x) {
      const int right = std::min(x + 1, width - 1);
      const uint32_t quad = uint32_t(upper[x]) | uint32_t(upper[right]) << 8 |
                            uint32_t(lower[x]) << 16 | uint32_t(lower[right]) << 24;
      quads[size_t(y) * width + x] = quad ^ 0x80808080u;
    }
  }
}

std::vector<uint8_t> Padded(const uint8_t* grey, int width, int height, int margin) {
  const int stride = width + 2 * margin;
  std::vector<uint8_t> padded(size_t(stride) * (height + 2 * margin));
  for (int y = -margin; y < height + margin; ++y) {
    const uint8_t* from = grey + int64_t(std::clamp(y, 0, height - 1)) * width;
    uint8_t* to = padded.data() + int64_t(y + margin) * stride;
    for (int x = -margin; x < width + margin; ++x)
      to[x + margin] = from[std::clamp(x, 0, width - 1)];
  }
  return padded;
}

}  // namespace sirpy::patch_match
