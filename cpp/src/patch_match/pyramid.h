// Pixels of a pyramid level, the same whatever the window, and images packed for the kernels.
#pragma once

#include <cstdint>
#include <vector>

namespace sirpy::patch_match {

// The mean of each block of `factor` x `factor` pixels, rounded once; at the right and lower border
// of what there is. The window must start at a multiple of `factor` pixels of its image. The result
// has ceil(width / factor) x ceil(height / factor) pixels.
std::vector<uint8_t> Shrunk(const uint8_t* grey, int width, int height, int factor);

// Each pixel with its right, lower and lower-right neighbours in one word, clamped at the border:
// one load gives what bilinear interpolation needs. Bytes with a sign, grey - 128: a product with
// an 8-bit weight then fits 16 bits. 4 bytes per pixel.
void PackQuads(const uint8_t* grey, int width, int height, uint32_t* quads);

// The image with `margin` more pixels on each side, which repeat its border.
std::vector<uint8_t> Padded(const uint8_t* grey, int width, int height, int margin);

}  // namespace sirpy::patch_match
