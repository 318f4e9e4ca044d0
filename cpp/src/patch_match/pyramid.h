// Image pyramids whose pixels are the same whatever the window: level l + 1 averages 2x2 blocks of
// level l that start at even native pixels, so windows must start at multiples of 2^(levels - 1).
#pragma once

#include <cstdint>
#include <vector>

namespace sirpy::patch_match {

struct GreyImage {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> pixels;  // height x width
};

// Levels 1 .. levels - 1 of an image (level 0 is the image itself). A last odd row or column is
// averaged from what there is.
std::vector<GreyImage> Pyramid(const uint8_t* grey, int width, int height, int levels);

// Each pixel with its right, lower and lower-right neighbours in one word, clamped at the border:
// one load gives what bilinear interpolation needs. Bytes with a sign, grey - 128: a product with
// an 8-bit weight then fits 16 bits. 4 bytes per pixel.
void PackQuads(const uint8_t* grey, int width, int height, uint32_t* quads);

// The image with `margin` more pixels on each side, which repeat its border.
std::vector<uint8_t> Padded(const uint8_t* grey, int width, int height, int margin);

}  // namespace sirpy::patch_match
