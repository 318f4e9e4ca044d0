// Compiled once for each instruction set with SIRPY_ISA (a namespace) and SIRPY_LANES. No standard
// library here: nothing that the linker could share between instruction sets.
//
// Positions have a pixel in each lane, features neighbouring channels of one pixel. Sums of
// products have an order that does not depend on the number of lanes: four sums over every fourth
// channel of a group, then these.
#include "patchmatchnet/correlation_kernels.h"

#include "patch_match/lanes.h"

namespace sirpy::patchmatchnet::SIRPY_ISA {
namespace {

using namespace patch_match::SIRPY_ISA;

// A block's rays: depth times ray, plus the translation, is where the source sees a pixel.
struct Rays {
  Floats x[kBlock / kLanes], y[kBlock / kLanes], z[kBlock / kLanes];
};

// The four pixels of the source around a position, row by row, and their weights: 0 of those that
// are not in its map, for which the next one stands.
struct Taps {
  int32_t pixel[4][kBlock];
  float weight[4][kBlock];
};

// A position between two columns, or rows, of which there are `count`.
struct Between {
  Ints first, second;
  Floats first_weight, second_weight;

  SIRPY_INLINE Between Of(Floats position, int32_t count) {
    // Positions further out have no weight either, and fit no integer.
    position = Min(Max(position, Splat(-1)), Splat(float(count)));
    Ints below = Truncate(position);
    below += ToFloats(below) > position;  // a true comparison is -1: floor
    const Floats share = position - ToFloats(below);
    const Ints last = SplatInt(count - 1), above = below + 1;
    const Ints has_first = (below >= 0) & (below <= last), has_second = above <= last;
    const Ints zero = {};
    return {Select(has_first, below, Select(below < 0, zero, last)),
            Select(has_second, above, last), Select(has_first, 1.f - share, Floats{}),
            Select(has_second, share, Floats{})};
  }
};

SIRPY_INLINE Floats Load(const float* numbers) {
  Floats found;
  __builtin_memcpy(&found, numbers, sizeof found);
  return found;
}

template <typename Number, typename Lanes>
SIRPY_INLINE void Store(Lanes lanes, Number* numbers) {
  __builtin_memcpy(numbers, &lanes, sizeof lanes);
}

SIRPY_INLINE Rays RaysOf(const Correlation& c, int64_t x, int64_t row) {
  const float* m = c.source_from_reference;
  const float y = float(c.first_row + row);
  Rays rays;
  for (int part = 0; part < kBlock / kLanes; ++part) {
    Floats column;
    for (int lane = 0; lane < kLanes; ++lane) column[lane] = float(x + part * kLanes + lane);
    rays.x[part] = m[0] * column + m[1] * y + m[2];
    rays.y[part] = m[4] * column + m[5] * y + m[6];
    rays.z[part] = m[8] * column + m[9] * y + m[10];
  }
  return rays;
}

SIRPY_INLINE void FindTaps(const Correlation& c, const Rays& rays, const float* depths,
                           Taps* taps) {
  const float* m = c.source_from_reference;
  for (int part = 0; part < kBlock / kLanes; ++part) {
    const Floats depth = Load(depths + part * kLanes);
    const Floats z = rays.z[part] * depth + m[11];
    const Ints seen = z > kNearest;
    const Floats u = Select(seen, (rays.x[part] * depth + m[3]) / z, Splat(c.behind_u));
    const Floats v = Select(seen, (rays.y[part] * depth + m[7]) / z, Splat(c.behind_v));
    const Between columns = Between::Of(u, c.source_width);
    const Between rows = Between::Of(v, c.source_height);
    const Ints above = rows.first * c.source_width, below = rows.second * c.source_width;
    const int at = part * kLanes;
    Store(above + columns.first, taps->pixel[0] + at);
    Store(above + columns.second, taps->pixel[1] + at);
    Store(below + columns.first, taps->pixel[2] + at);
    Store(below + columns.second, taps->pixel[3] + at);
    Store(rows.first_weight * columns.first_weight, taps->weight[0] + at);
    Store(rows.first_weight * columns.second_weight, taps->weight[1] + at);
    Store(rows.second_weight * columns.first_weight, taps->weight[2] + at);
    Store(rows.second_weight * columns.second_weight, taps->weight[3] + at);
  }
}

// Of each of the first `count` pixels of a block, channel by channel.
SIRPY_INLINE void Multiply(const Correlation& c, const float* reference, const Taps& taps,
                           int64_t count) {
  const int64_t channels = c.channels;
  for (int64_t i = 0; i < count; ++i) {
    const float* taken[4];
    for (int tap = 0; tap < 4; ++tap) taken[tap] = c.source + taps.pixel[tap][i] * channels;
    const float w0 = taps.weight[0][i], w1 = taps.weight[1][i];
    const float w2 = taps.weight[2][i], w3 = taps.weight[3][i];
    const float* of_reference = reference + i * channels;
    float* product = c.products + i * channels;
    for (int64_t k = 0; k < channels; k += kLanes) {
      const Floats seen = w0 * Load(taken[0] + k) + w1 * Load(taken[1] + k) +
                          w2 * Load(taken[2] + k) + w3 * Load(taken[3] + k);
      Store(Load(of_reference + k) * seen, product + k);
    }
  }
}

typedef float Four __attribute__((vector_size(16)));

// The sum of every fourth of `count` numbers.
SIRPY_INLINE Four FourSums(const float* numbers, int64_t count) {
  Four sums;
  __builtin_memcpy(&sums, numbers, sizeof sums);
  for (int64_t k = 4; k < count; k += 4) {
    Four next;
    __builtin_memcpy(&next, numbers + k, sizeof next);
    sums += next;
  }
  return sums;
}

// a[0] + a[2], a[1] + a[3] and the same of b.
SIRPY_INLINE Four Halved(Four a, Four b) {
  return Four{a[0], a[1], b[0], b[1]} + Four{a[2], a[3], b[2], b[3]};
}

// The mean products of group `group` of a block.
SIRPY_INLINE void Means(const Correlation& c, int64_t group, float* means) {
  const int64_t size = c.channels / c.groups;
  const float* products = c.products + group * size;
  for (int64_t i = 0; i < kBlock; i += 4, products += 4 * c.channels) {
    const Four two = Halved(FourSums(products, size), FourSums(products + c.channels, size));
    const Four four = Halved(FourSums(products + 2 * c.channels, size),
                             FourSums(products + 3 * c.channels, size));
    const Four sums =
        Four{two[0], two[2], four[0], four[2]} + Four{two[1], two[3], four[1], four[3]};
    Store(sums / float(size), means + i);
  }
}

// Of `count` pixels of a row, from x on.
template <bool whole>
SIRPY_INLINE void CorrelateBlock(const Correlation& c, int64_t row, int64_t x, int64_t count) {
  const int64_t plane = c.height * c.width, first = row * c.width + x;
  const Rays rays = RaysOf(c, x, row);
  for (int64_t hypothesis = 0; hypothesis < c.hypotheses; ++hypothesis) {
    const float* depth = c.depth + hypothesis * plane + first;
    float block[kBlock] = {};
    if (!whole) {
      for (int64_t i = 0; i < count; ++i) block[i] = depth[i];
    }
    Taps taps;
    FindTaps(c, rays, whole ? depth : block, &taps);
    Multiply(c, c.reference + first * c.channels, taps, count);
    for (int64_t group = 0; group < c.groups; ++group) {
      float* found = c.found + (group * c.hypotheses + hypothesis) * plane + first;
      Means(c, group, whole ? found : block);
      if (!whole) {
        for (int64_t i = 0; i < count; ++i) found[i] = block[i];
      }
    }
  }
}

void CorrelateAll(const Correlation& c) {
  for (int64_t row = 0; row < c.height; ++row) {
    int64_t x = 0;
    for (; x + kBlock <= c.width; x += kBlock) CorrelateBlock<true>(c, row, x, kBlock);
    if (x < c.width) CorrelateBlock<false>(c, row, x, c.width - x);
  }
}

}  // namespace

extern const Correlate kCorrelate;
const Correlate kCorrelate = CorrelateAll;

}  // namespace sirpy::patchmatchnet::SIRPY_ISA
