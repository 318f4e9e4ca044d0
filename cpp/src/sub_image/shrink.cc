#include "sub_image/shrink.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace sirpy {

Shrink::Shrink(const ImageShape& source, int64_t width, int64_t height,
               std::unique_ptr<RowSink> next)
    : source_(source), width_(width), height_(height), next_(std::move(next)) {
  if (width < 1 || height < 1 || width > source.width || height > source.height) {
    throw std::invalid_argument("Shrink: an output side must be between 1 and the input's");
  }
  sums_.resize(width_ * source_.channels);
  out_.resize(width_ * source_.channels);
}

void Shrink::Push(const uint8_t* rows, int64_t count) {
  const int64_t sums = width_ * source_.channels;
  row_sums_.resize(count * sums);
#pragma omp parallel for
  for (int64_t row = 0; row < count; ++row) {
    ShrinkRow(rows + row * source_.RowBytes(), &row_sums_[row * sums]);
  }
  for (int64_t row = 0; row < count; ++row) AddRow(&row_sums_[row * sums]);
}

void Shrink::Finish() { next_->Finish(); }

// In units of 1 / width_ input pixel: input pixel x covers [x * n, (x + 1) * n), output pixel i
// covers [i * N, (i + 1) * N), n = width_, N = source_.width. A sum is at most 255 N.
void Shrink::ShrinkRow(const uint8_t* row, uint32_t* sums) const {
  const int64_t n = width_;
  const int channels = source_.channels;
  for (int64_t i = 0; i < n; ++i, sums += channels) {
    const int64_t begin = i * source_.width;
    const int64_t end = begin + source_.width;
    const int64_t first = begin / n;
    const int64_t last = (end - 1) / n;
    for (int channel = 0; channel < channels; ++channel) {
      const uint8_t* pixel = row + first * channels + channel;
      uint32_t inner = 0;
      for (int64_t x = first + 1; x < last; ++x) inner += pixel[(x - first) * channels];
      uint32_t sum = inner * static_cast<uint32_t>(n);
      sum += *pixel * static_cast<uint32_t>(std::min((first + 1) * n, end) - begin);
      if (last > first) {
        sum += pixel[(last - first) * channels] * static_cast<uint32_t>(end - last * n);
      }
      sums[channel] = sum;
    }
  }
}

void Shrink::AddRow(const uint32_t* sums) {
  const int64_t n = height_;
  const int64_t begin = input_row_ * n;
  const int64_t end = begin + n;
  const int64_t boundary = (output_row_ + 1) * source_.height;
  ++input_row_;
  // An input row is at most one output row high, so it meets two of them at most.
  Add(sums, std::min(end, boundary) - begin);
  if (end >= boundary) {
    EmitRow();
    if (end > boundary) Add(sums, end - boundary);
  }
}

void Shrink::Add(const uint32_t* sums, uint64_t weight) {
  for (size_t i = 0; i < sums_.size(); ++i) sums_[i] += weight * sums[i];
}

void Shrink::EmitRow() {
  const uint64_t area = static_cast<uint64_t>(source_.width) * source_.height;
  for (size_t i = 0; i < sums_.size(); ++i) {
    out_[i] = static_cast<uint8_t>((sums_[i] + area / 2) / area);
    sums_[i] = 0;
  }
  ++output_row_;
  next_->Push(out_.data(), 1);
}

}  // namespace sirpy
