// Positions in a photograph in whole numbers of 1 / kSubPixels pixel, the centre of the top-left
// pixel at (0, 0): pixel (i, j) has its centre at (kSubPixels * i, kSubPixels * j).
#pragma once

#include <cstdint>

namespace sirpy {

constexpr int kSubPixelBits = 11;
constexpr int32_t kSubPixels = 1 << kSubPixelBits;

// Of a photograph, pixels: positions 2.67 times as far, with the bias below, fit into 32 bits.
constexpr int kLargestSide = 120000;

// `position` is COLMAP's, with the centre of the top-left pixel at 0.5. Without floor(), so that
// compilers vectorise it: the bias makes the conversion round downwards. Always inlined, since
// kernels are compiled for several instruction sets.
__attribute__((always_inline)) inline int32_t ToSubPixels(double position) {
  constexpr int32_t kBias = 1 << 29;
  return static_cast<int32_t>((position - 0.5) * kSubPixels + (kBias + 0.5)) - kBias;
}

}  // namespace sirpy
