#include "sub_image/warp.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <utility>

#include "error.h"
#include "sub_image/sub_pixels.h"

namespace sirpy {
namespace {

constexpr int64_t kBandRows = 16;

}  // namespace

Warp::Warp(std::shared_ptr<const LensMap> lens, const Rectangle& window, const ImageShape& source,
           Interpolation interpolation, std::unique_ptr<RowSink> next)
    : lens_(std::move(lens)),
      window_(window),
      source_(source),
      interpolation_(interpolation),
      kernels_(warp::BestKernels()),
      sample_row_(ChooseSampleRow(interpolation, source)),
      next_(std::move(next)) {
  if (std::max(source_.width, source_.height) > kLargestSide) {
    throw InputError("a photograph of " + std::to_string(source_.width) + "x" +
                     std::to_string(source_.height) +
                     " pixels is larger than can be undistorted (" + std::to_string(kLargestSide) +
                     "): cut it first");
  }
  const int64_t pixels = std::min(kBandRows, window_.height) * window_.width;
  band_x_.resize(pixels);
  band_y_.resize(pixels);
  band_out_.resize(pixels * source_.PixelBytes());
  // The last band first, to see where the window ends.
  band_rows_ = std::min(kBandRows, window_.height);
  band_begin_ = window_.y1() - band_rows_;
  PlaceBand();
  expected_end_ = band_last_ + 1;
  band_begin_ = window_.y0;
  PlaceBand();
  first_row_ = first_kept_ = received_ = band_first_;
}

void Warp::Push(const uint8_t* rows, int64_t count) {
  Keep(rows, count);
  while (band_rows_ > 0 && BandIsReady()) {
    EmitBand();
    BeginBand();
    if (band_rows_ > 0 && band_first_ < first_kept_) {
      throw InputError(
          "the lens of a camera folds the image over itself, so it cannot be undistorted: use a "
          "smaller --blank_pixels or --max_scale, or solve the camera again");
    }
    first_kept_ = std::min(band_first_, received_);
  }
}

void Warp::Finish() { next_->Finish(); }

void Warp::Keep(const uint8_t* rows, int64_t count) {
  if (Done()) {  // no later row is needed
    received_ += count;
    return;
  }
  const int64_t bytes = source_.RowBytes();
  if (received_ + count - first_kept_ > capacity_) {
    int64_t capacity = std::max<int64_t>(capacity_, kBandRows);
    while (received_ + count - first_kept_ > capacity) capacity *= 2;
    std::vector<uint8_t> larger(capacity * bytes + warp::kRingPadding);
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
  band_rows_ = std::min(kBandRows, window_.y1() - band_begin_);
  if (band_rows_ > 0) PlaceBand();
}

void Warp::PlaceBand() {
  const int64_t width = window_.width;
  int32_t lowest = INT32_MAX;
  int32_t highest = INT32_MIN;
#pragma omp parallel for reduction(min : lowest) reduction(max : highest)
  for (int64_t row = 0; row < band_rows_; ++row) {
    int32_t* x = &band_x_[row * width];
    int32_t* y = &band_y_[row * width];
    lens_->Row(kernels_, band_begin_ + row, window_.x0, width, x, y);
    for (int64_t column = 0; column < width; ++column) {
      lowest = std::min(lowest, y[column]);
      highest = std::max(highest, y[column]);
    }
  }
  // Pixels left or right of the photograph count too: the first row then never moves back up.
  const auto clamp = [this](int64_t row) {
    return std::clamp<int64_t>(row, 0, source_.height - 1);
  };
  band_first_ = clamp((lowest >> kSubPixelBits) - RowsAbove(interpolation_));
  band_last_ = clamp((highest >> kSubPixelBits) + RowsBelow(interpolation_));
}

bool Warp::BandIsReady() const { return band_last_ < received_; }

void Warp::EmitBand() {
  const int64_t width = window_.width;
  const warp::SourceRows source{kept_.data(), capacity_ - 1, source_.RowBytes(),
                                static_cast<int32_t>(source_.width),
                                static_cast<int32_t>(source_.height)};
#pragma omp parallel for schedule(dynamic)
  for (int64_t row = 0; row < band_rows_; ++row) {
    sample_row_(source, source_.channels, &band_x_[row * width], &band_y_[row * width], width,
                &band_out_[row * width * source_.PixelBytes()]);
  }
  next_->Push(band_out_.data(), band_rows_);
}

}  // namespace sirpy
