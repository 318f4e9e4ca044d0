#include "sub_image/interpolation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "sub_image/sub_pixels.h"

namespace sirpy {
namespace {

using warp::SourceRows;

constexpr int kWeightBits = 14;
constexpr int32_t kWeightOne = 1 << kWeightBits;

double CatmullRom(double x) {
  x = std::abs(x);
  if (x < 1) return (1.5 * x - 2.5) * x * x + 1;
  if (x < 2) return ((-0.5 * x + 2.5) * x - 4) * x + 2;
  return 0;
}

double Lanczos3(double x) {
  if (x == 0) return 1;
  if (std::abs(x) >= 3) return 0;
  const double angle = 3.14159265358979323846 * x;
  return 3 * std::sin(angle) * std::sin(angle / 3) / (angle * angle);
}

// Whole-number weights of the taps -(kTaps / 2 - 1) .. kTaps / 2 for each sub-pixel; their sum is
// one exactly, so that flat colour stays as it is.
template <int kTaps>
struct WeightTable {
  std::array<std::array<int32_t, kTaps>, kSubPixels> rows;

  explicit WeightTable(double (*kernel)(double)) {
    for (int i = 0; i < kSubPixels; ++i) {
      std::array<double, kTaps> exact;
      double sum = 0;
      for (int tap = 0; tap < kTaps; ++tap) {
        exact[tap] = kernel(tap - (kTaps / 2 - 1) - static_cast<double>(i) / kSubPixels);
        sum += exact[tap];
      }
      int32_t left = kWeightOne;
      for (int tap = 0; tap < kTaps; ++tap) {
        rows[i][tap] = static_cast<int32_t>(std::lround(exact[tap] / sum * kWeightOne));
        left -= rows[i][tap];
      }
      rows[i][i < kSubPixels / 2 ? kTaps / 2 - 1 : kTaps / 2] +=
          left;  // the nearest takes the rest
    }
  }
};

// The kernel only where it is asked for: 2048 rows of weights, made once.
const WeightTable<4>& BicubicWeights() {
  static const WeightTable<4> table(CatmullRom);
  return table;
}
const WeightTable<6>& LanczosWeights() {
  static const WeightTable<6> table(Lanczos3);
  return table;
}

template <typename Sample>
const Sample* Row(const SourceRows& source, int64_t row) {
  return reinterpret_cast<const Sample*>(source.slots +
                                         (row & source.slot_mask) * source.row_bytes);
}

// Calls sample(left, top, out) for pixels inside the outermost centres, and blackens the others.
template <typename Sample, typename Function>
void ForPixels(const SourceRows& source, int channels, const int32_t* x, const int32_t* y,
               int64_t count, uint8_t* out, Function sample) {
  Sample* pixel = reinterpret_cast<Sample*>(out);
  for (int64_t i = 0; i < count; ++i, pixel += channels) {
    const int32_t left = x[i] >> kSubPixelBits;
    const int32_t top = y[i] >> kSubPixelBits;
    if (left < 0 || top < 0 || left >= source.width - 1 || top >= source.height - 1) {
      std::fill_n(pixel, channels, Sample{0});
    } else {
      sample(left, top, x[i] & (kSubPixels - 1), y[i] & (kSubPixels - 1), pixel);
    }
  }
}

template <typename Sample>
void Nearest(const SourceRows& source, int channels, const int32_t* x, const int32_t* y,
             int64_t count, uint8_t* out) {
  ForPixels<Sample>(source, channels, x, y, count, out,
                    [&](int32_t left, int32_t top, int32_t dx, int32_t dy, Sample* pixel) {
                      const int64_t column = left + (dx >= kSubPixels / 2);
                      const int64_t row = top + (dy >= kSubPixels / 2);
                      std::copy_n(Row<Sample>(source, row) + column * channels, channels, pixel);
                    });
}

template <typename Sample>
void Bilinear(const SourceRows& source, int channels, const int32_t* x, const int32_t* y,
              int64_t count, uint8_t* out) {
  constexpr int kShift = 2 * kSubPixelBits;
  ForPixels<Sample>(
      source, channels, x, y, count, out,
      [&](int32_t left, int32_t top, int64_t dx, int64_t dy, Sample* pixel) {
        const Sample* above = Row<Sample>(source, top) + int64_t{left} * channels;
        const Sample* below = Row<Sample>(source, top + 1) + int64_t{left} * channels;
        for (int c = 0; c < channels; ++c) {
          const int64_t upper = above[c] * (kSubPixels - dx) + above[c + channels] * dx;
          const int64_t lower = below[c] * (kSubPixels - dx) + below[c + channels] * dx;
          const int64_t sum = upper * (kSubPixels - dy) + lower * dy;
          pixel[c] = static_cast<Sample>((sum + (1 << (kShift - 1))) >> kShift);
        }
      });
}

// Taps beyond the photograph repeat its border.
template <typename Sample, int kTaps, const WeightTable<kTaps>& (*kTable)()>
void Separable(const SourceRows& source, int channels, const int32_t* x, const int32_t* y,
               int64_t count, uint8_t* out) {
  constexpr int kShift = 2 * kWeightBits;
  constexpr int64_t kLargest = std::numeric_limits<Sample>::max();
  const WeightTable<kTaps>& table = kTable();
  ForPixels<Sample>(
      source, channels, x, y, count, out,
      [&](int32_t left, int32_t top, int32_t dx, int32_t dy, Sample* pixel) {
        std::array<const Sample*, kTaps> rows;
        std::array<int64_t, kTaps> columns;
        for (int tap = 0; tap < kTaps; ++tap) {
          const int offset = tap - (kTaps / 2 - 1);
          rows[tap] = Row<Sample>(source, std::clamp(top + offset, 0, source.height - 1));
          columns[tap] = int64_t{std::clamp(left + offset, 0, source.width - 1)} * channels;
        }
        for (int c = 0; c < channels; ++c) {
          int64_t sum = 0;
          for (int row = 0; row < kTaps; ++row) {
            int64_t across = 0;
            for (int tap = 0; tap < kTaps; ++tap) {
              across += int64_t{rows[row][columns[tap] + c]} * table.rows[dx][tap];
            }
            sum += across * table.rows[dy][row];
          }
          const int64_t rounded = (sum + (int64_t{1} << (kShift - 1))) >> kShift;
          pixel[c] = static_cast<Sample>(std::clamp<int64_t>(rounded, 0, kLargest));
        }
      });
}

template <typename Sample>
warp::SampleRow ChooseFor(Interpolation interpolation) {
  switch (interpolation) {
    case Interpolation::kNearest:
      return Nearest<Sample>;
    case Interpolation::kBilinear:
      return Bilinear<Sample>;
    case Interpolation::kBicubic:
      return Separable<Sample, 4, BicubicWeights>;
    case Interpolation::kLanczos:
      return Separable<Sample, 6, LanczosWeights>;
  }
  return nullptr;
}

}  // namespace

int RowsAbove(Interpolation interpolation) {
  if (interpolation == Interpolation::kLanczos) return 2;
  return interpolation == Interpolation::kBicubic ? 1 : 0;
}

int RowsBelow(Interpolation interpolation) { return RowsAbove(interpolation) + 1; }

warp::SampleRow ChooseSampleRow(Interpolation interpolation, const ImageShape& photograph) {
  if (photograph.sample_bytes == 2) return ChooseFor<uint16_t>(interpolation);
  if (interpolation == Interpolation::kBilinear) {
    if (photograph.channels == 1) return warp::BestKernels().bilinear_grey8;
    if (photograph.channels == 3) return warp::BestKernels().bilinear_rgb8;
  }
  return ChooseFor<uint8_t>(interpolation);
}

}  // namespace sirpy
