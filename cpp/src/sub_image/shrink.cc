#include "sub_image/shrink.h"

#include <algorithm>
#include <stdexcept>
#include <type_traits>
#include <utility>

namespace sirpy {

Shrink::Shrink(const ImageShape& source, int64_t width, int64_t height,
               std::unique_ptr<RowSink> next)
    : source_(source), width_(width), height_(height), next_(std::move(next)) {
  if (width < 1 || height < 1 || width > source.width || height > source.height) {
    throw std::invalid_argument("Shrink: an output side must be between 1 and the input's");
  }
  sums_.resize(width_ * source_.channels);
  out_.resize(width_ * source_.PixelBytes());
}

void Shrink::Push(const uint8_t* rows, int64_t count) {
  const int64_t sums = width_ * source_.channels;
  row_sums_.resize(count * sums);
#pragma omp parallel for
  for (int64_t row = 0; row < count; ++row) {
    const uint8_t* bytes = rows + row * source_.RowBytes();
    if (source_.sample_bytes == 1) {
      ShrinkRow(bytes, &row_sums_[row * sums]);
    } else {
      ShrinkRow(reinterpret_cast<const uint16_t*>(bytes), &row_sums_[row * sums]);
    }
  }
  for (int64_t row = 0; row < count; ++row) AddRow(&row_sums_[row * sums]);
}

void Shrink::Finish() { next_->Finish(); }

// In units of 1 / width_ input pixel: input pixel x covers [x * n, (x + 1) * n), output pixel i
// covers [i * N, (i + 1) * N), n = width_, N = source_.width. A sum of bytes is at
// most 255 N, which fits into 32 bits.
template <typename Sample>
void Shrink::ShrinkRow(const Sample* row, uint64_t* sums) const {
  using Sum = std::conditional_t<sizeof(Sample) == 1, uint32_t, uint64_t>;
  const int64_t n = width_;
  const int channels = source_.channels;
  for (int64_t i = 0; i < n; ++i, sums += channels) {
    const int64_t begin = i * source_.width;
    const int64_t end = begin + source_.width;
    const int64_t first = begin / n;
    const int64_t last = (end - 1) / n;
    for (int channel = 0; channel < channels; ++channel) {
      const Sample* pixel = row + first * channels + channel;
      Sum inner = 0;
      for (int64_t x = first + 1; x < last; ++x) inner += pixel[(x - first) * channels];
      Sum sum = inner * static_cast<Sum>(n);
      sum += *pixel * static_cast<Sum>(std::min((first + 1) * n, end) - begin);
      if (last > first) {
        sum += pixel[(last - first) * channels] * static_cast<Sum>(end - last * n);
      }
      sums[channel] = sum;
    }
  }
}

void Shrink::AddRow(const uint64_t* sums) {
  const int64_t n = height_;
  const int64_t begin = input_row_ * n;
  const int64_t end = begin + n;
  const int64_t boundary = (output_row_ + 1) * source_.height;
  ++input_row_;
  // An input row is at most one output row high, so it meets two of them at most.
  Add(sums, std::min(end, boundary) - begin);
  if (end >= boundary) {
    source_.sample_bytes == 1 ? EmitRow<uint8_t>() : EmitRow<uint16_t>();
    if (end > boundary) Add(sums, end - boundary);
  }
}

void Shrink::Add(const uint64_t* sums, uint64_t weight) {
  for (size_t i = 0; i < sums_.size(); ++i) sums_[i] += weight * sums[i];
}

template <typename Sample>
void Shrink::EmitRow() {
  Sample* out = reinterpret_cast<Sample*>(out_.data());
  const uint64_t area = static_cast<uint64_t>(source_.width) * source_.height;
  for (size_t i = 0; i < sums_.size(); ++i) {
    out[i] = static_cast<Sample>((sums_[i] + area / 2) / area);
    sums_[i] = 0;
  }
  ++output_row_;
  next_->Push(out_.data(), 1);
}

}  // namespace sirpy
