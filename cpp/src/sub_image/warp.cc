#include "sub_image/warp.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <utility>

#include "error.h"

namespace sirpy {
namespace {

constexpr int64_t kBandRows = 64;

}  // namespace

Warp::Warp(std::shared_ptr<const LensMap> lens, const ImageShape& source,
           std::unique_ptr<RowSink> next)
    : lens_(std::move(lens)), source_(source), next_(std::move(next)) {
  if (std::max(source_.width, source_.height) > LensMap::kLargestSide) {
    throw InputError("a photograph of " + std::to_string(source_.width) + "x" +
                     std::to_string(source_.height) +
                     " pixels is larger than can be undistorted (" +
                     std::to_string(LensMap::kLargestSide) + "): cut it first");
  }
  const int64_t pixels = kBandRows * lens_->width();
  band_x_.resize(pixels);
  band_y_.resize(pixels);
  band_out_.resize(pixels * source_.channels);
  BeginBand();
}

void Warp::Push(const uint8_t* rows, int64_t count) {
  Keep(rows, count);
  while (band_rows_ > 0 && BandIsReady()) {
    EmitBand();
    BeginBand();
  }
}

void Warp::Finish() { next_->Finish(); }

void Warp::Keep(const uint8_t* rows, int64_t count) {
  if (band_rows_ == 0) {  // all bands are done; no later row is needed
    received_ += count;
    return;
  }
  const int64_t bytes = source_.RowBytes();
  if (received_ + count - first_kept_ > capacity_) {
    int64_t capacity = std::max<int64_t>(capacity_, kBandRows);
    while (received_ + count - first_kept_ > capacity) capacity *= 2;
    std::vector<uint8_t> larger(capacity * bytes);
    for (int64_t row = first_kept_; row < received_; ++row) {
      std::memcpy(&larger[(row & (capacity - 1)) * bytes], Slot(row), bytes);
    }
    kept_ = std::move(larger);
    capacity_ = capacity;
  }
  for (int64_t row = 0; row < count; ++row) {
    std::memcpy(Slot(received_ + row), rows + row * bytes, bytes);
  }
  received_ += count;
}

void Warp::BeginBand() {
  band_begin_ += band_rows_;
  band_rows_ = std::min(kBandRows, lens_->height() - band_begin_);
  const int64_t width = lens_->width();
  int32_t lowest = INT32_MAX;
  int32_t highest = INT32_MIN;
#pragma omp parallel for reduction(min : lowest) reduction(max : highest)
  for (int64_t row = 0; row < band_rows_; ++row) {
    int32_t* x = &band_x_[row * width];
    int32_t* y = &band_y_[row * width];
    lens_->Row(band_begin_ + row, x, y);
    for (int64_t column = 0; column < width; ++column) {
      lowest = std::min(lowest, y[column]);
      highest = std::max(highest, y[column]);
    }
  }
  if (band_rows_ == 0) return;
  // Pixels left or right of the photograph count too: the first row then never moves back up.
  const auto clamp = [this](int64_t row) {
    return std::clamp<int64_t>(row, 0, source_.height - 1);
  };
  band_first_ = clamp(lowest >> LensMap::kSubPixelBits);
  band_last_ = clamp((highest >> LensMap::kSubPixelBits) + 1);
  if (band_first_ < first_kept_) {
    throw InputError(
        "the lens of a camera folds the image over itself, so it cannot be undistorted: use a "
        "smaller "
        "--blank_pixels or --max_scale, or solve the camera again");
  }
  first_kept_ = std::min(band_first_, received_);
}

bool Warp::BandIsReady() const { return band_last_ < received_; }

void Warp::EmitBand() {
  const int64_t width = lens_->width();
#pragma omp parallel for
  for (int64_t row = 0; row < band_rows_; ++row) {
    const int32_t* x = &band_x_[row * width];
    const int32_t* y = &band_y_[row * width];
    uint8_t* out = &band_out_[row * width * source_.channels];
    if (source_.channels == 3) {
      WarpRow<3>(x, y, out);
    } else {
      WarpRow<1>(x, y, out);
    }
  }
  next_->Push(band_out_.data(), band_rows_);
}

template <int kChannels>
void Warp::WarpRow(const int32_t* x, const int32_t* y, uint8_t* out) const {
  constexpr int32_t kOne = LensMap::kSubPixels;
  constexpr int kShift = 2 * LensMap::kSubPixelBits;
  // One comparison each: a negative index becomes a huge one.
  const uint32_t end_x = static_cast<uint32_t>(source_.width - 1);
  const uint32_t end_y = static_cast<uint32_t>(source_.height - 1);
  // Copies of members: bytes written through `out` might otherwise be taken for them.
  const uint8_t* const kept = kept_.data();
  const int64_t slots = capacity_ - 1;
  const int64_t row_bytes = source_.RowBytes();
  const int64_t width = lens_->width();
  for (int64_t column = 0; column < width; ++column, out += kChannels) {
    const int32_t left = x[column] >> LensMap::kSubPixelBits;
    const int32_t top = y[column] >> LensMap::kSubPixelBits;
    if (static_cast<uint32_t>(left) >= end_x || static_cast<uint32_t>(top) >= end_y) {
      for (int channel = 0; channel < kChannels; ++channel) out[channel] = 0;
      continue;
    }
    const int32_t dx = x[column] & (kOne - 1);
    const int32_t dy = y[column] & (kOne - 1);
    const int32_t below_right = dx * dy;
    const int32_t below_left = kOne * dy - below_right;
    const int32_t above_right = kOne * dx - below_right;
    const int32_t above_left = kOne * kOne - kOne * dy - above_right;
    const uint8_t* above = kept + (top & slots) * row_bytes + kChannels * left;
    const uint8_t* below = kept + ((top + 1) & slots) * row_bytes + kChannels * left;
    for (int channel = 0; channel < kChannels; ++channel) {
      const int32_t sum = above[channel] * above_left + above[channel + kChannels] * above_right +
                          below[channel] * below_left + below[channel + kChannels] * below_right;
      out[channel] = static_cast<uint8_t>((sum + (1 << (kShift - 1))) >> kShift);
    }
  }
}

}  // namespace sirpy
