// Compiled once for each instruction set with SIRPY_ISA (a namespace). No standard library here:
// nothing that the linker could share between instruction sets. Plain loops over chunks, which the
// compiler vectorises; all sums are of integers, so every instruction set gives the same bytes.
#include "sub_image/warp_kernels.h"

#include "sub_image/sub_pixels.h"

namespace sirpy::warp::SIRPY_ISA {
namespace {

constexpr int kChunk = 64;  // pixels whose corners are gathered before they are weighed
constexpr uint8_t kBlack[16] = {};

struct Weights {
  int32_t above_left, above_right, below_left, below_right;
};

inline Weights BilinearWeights(int32_t x, int32_t y) {
  const int32_t dx = x & (kSubPixels - 1);
  const int32_t dy = y & (kSubPixels - 1);
  const int32_t below_right = dx * dy;
  const int32_t below_left = kSubPixels * dy - below_right;
  const int32_t above_right = kSubPixels * dx - below_right;
  const int32_t above_left = kSubPixels * kSubPixels - kSubPixels * dy - above_right;
  return {above_left, above_right, below_left, below_right};
}

inline uint8_t Rounded(int32_t sum) {
  constexpr int kShift = 2 * kSubPixelBits;
  return static_cast<uint8_t>((sum + (1 << (kShift - 1))) >> kShift);
}

inline uint32_t Load(const uint8_t* bytes) {
  uint32_t word;
  __builtin_memcpy(&word, bytes, sizeof word);
  return word;
}

// The corners of `count` <= kChunk pixels: four bytes from each on, of which the lowest `kChannels`
// are the pixel's.
struct Corners {
  uint32_t above_left[kChunk], above_right[kChunk], below_left[kChunk], below_right[kChunk];

  template <int kChannels>
  inline void Gather(const SourceRows& source, const int32_t* x, const int32_t* y, int64_t count) {
    // One comparison each: a negative index becomes a huge one.
    const uint32_t end_x = static_cast<uint32_t>(source.width - 1);
    const uint32_t end_y = static_cast<uint32_t>(source.height - 1);
    for (int64_t i = 0; i < count; ++i) {
      const int32_t left = x[i] >> kSubPixelBits;
      const int32_t top = y[i] >> kSubPixelBits;
      const bool inside = static_cast<uint32_t>(left) < end_x && static_cast<uint32_t>(top) < end_y;
      const uint8_t* slots = source.slots + int64_t{left} * kChannels;
      const uint8_t* above = slots + (top & source.slot_mask) * source.row_bytes;
      const uint8_t* below = slots + ((top + 1) & source.slot_mask) * source.row_bytes;
      above = inside ? above : kBlack;
      below = inside ? below : kBlack;
      above_left[i] = Load(above);
      above_right[i] = Load(above + kChannels);
      below_left[i] = Load(below);
      below_right[i] = Load(below + kChannels);
    }
  }
};

template <int kChannels>
void Bilinear8(const SourceRows& source, int /*channels*/, const int32_t* x, const int32_t* y,
               int64_t count, uint8_t* out) {
  Corners corners;
  uint8_t planes[kChannels][kChunk];
  for (; count > 0; count -= kChunk, x += kChunk, y += kChunk) {
    const int64_t chunk = count < kChunk ? count : kChunk;
    corners.Gather<kChannels>(source, x, y, chunk);
    for (int64_t i = 0; i < chunk; ++i) {
      const Weights w = BilinearWeights(x[i], y[i]);
      for (int channel = 0; channel < kChannels; ++channel) {
        const auto sample = [channel](uint32_t word) {
          return static_cast<int32_t>(word >> (8 * channel) & 255);
        };
        planes[channel][i] = Rounded(sample(corners.above_left[i]) * w.above_left +
                                     sample(corners.above_right[i]) * w.above_right +
                                     sample(corners.below_left[i]) * w.below_left +
                                     sample(corners.below_right[i]) * w.below_right);
      }
    }
    for (int64_t i = 0; i < chunk; ++i) {
      for (int channel = 0; channel < kChannels; ++channel) *out++ = planes[channel][i];
    }
  }
}

inline double Cubic(const double* c, double t) { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }

void Positions(const double* cubic_x, const double* cubic_y, int64_t first_column,
               double nodes_per_pixel, double first_node, int64_t count, int32_t* __restrict x,
               int32_t* __restrict y) {
  const int32_t first = static_cast<int32_t>(first_column);
  const int32_t end = static_cast<int32_t>(count);
  for (int32_t i = 0; i < end; ++i) {
    const double t = (first + i) * nodes_per_pixel - first_node;
    x[i] = ToSubPixels(Cubic(cubic_x, t));
    y[i] = ToSubPixels(Cubic(cubic_y, t));
  }
}

}  // namespace

extern const Kernels kKernels;
const Kernels kKernels = {Positions, Bilinear8<1>, Bilinear8<3>};

}  // namespace sirpy::warp::SIRPY_ISA
