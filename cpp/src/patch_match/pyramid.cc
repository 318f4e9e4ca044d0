#include "patch_match/pyramid.h"

#include <algorithm>

namespace sirpy::patch_match {
namespace {

GreyImage Halved(const uint8_t* grey, int width, int height) {
  GreyImage half{(width + 1) / 2, (height + 1) / 2, {}};
  half.pixels.resize(size_t(half.width) * half.height);
  for (int y = 0; y < half.height; ++y) {
    const uint8_t* upper = grey + int64_t(2 * y) * width;
    const uint8_t* lower = 2 * y + 1 < height ? upper + width : upper;
    for (int x = 0; x < half.width; ++x) {
      const int left = 2 * x, right = std::min(left + 1, width - 1);
      const int sum = upper[left] + upper[right] + lower[left] + lower[right];
      half.pixels[size_t(y) * half.width + x] = uint8_t((sum + 2) / 4);
    }
  }
  return half;
}

}  // namespace

std::vector<GreyImage> Pyramid(const uint8_t* grey, int width, int height, int levels) {
  std::vector<GreyImage> pyramid;
  for (int level = 1; level < levels; ++level) {
    const bool first = pyramid.empty();
    pyramid.push_back(Halved(first ? grey : pyramid.back().pixels.data(),
                             first ? width : pyramid.back().width,
                             first ? height : pyramid.back().height));
  }
  return pyramid;
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
