#include "tie_points/patch_cutter.h"

#include <algorithm>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "error.h"

namespace sirpy {
namespace {

constexpr int64_t kRows = 64;  // read at once

uint16_t Luma16(uint32_t red, uint32_t green, uint32_t blue, int shift) {
  return static_cast<uint16_t>((4899 * red + 9617 * green + 1868 * blue) >> shift);
}

// The luma of `count` pixels.
template <typename Sample>
void ToLuma(const Sample* pixels, int channels, int64_t count, uint16_t* luma) {
  // The weights add up to 2^14: 8 bit comes out times 256, 16 bit as it is.
  const int shift = sizeof(Sample) == 1 ? 6 : 14;
  for (int64_t i = 0; i < count; ++i, pixels += channels) {
    const bool color = channels >= 3;
    luma[i] = Luma16(pixels[0], pixels[color ? 1 : 0], pixels[color ? 2 : 0], shift);
  }
}

}  // namespace

PatchCutter::PatchCutter(const ImageShape& photograph, std::vector<std::array<int64_t, 2>> origins,
                         int side)
    : photograph_(photograph), origins_(std::move(origins)), by_row_(origins_.size()), side_(side) {
  if (side < 1) throw std::invalid_argument("a square has at least one pixel");
  for (const auto& [x, y] : origins_) {
    if (x < 0 || y < 0 || x + side > photograph.width || y + side > photograph.height) {
      throw std::invalid_argument("a square reaches beyond the photograph");
    }
    end_row_ = std::max(end_row_, y + side);
  }
  std::iota(by_row_.begin(), by_row_.end(), size_t{0});
  std::stable_sort(by_row_.begin(), by_row_.end(),
                   [&](size_t a, size_t b) { return origins_[a][1] < origins_[b][1]; });
  if (!by_row_.empty()) first_row_ = next_row_ = origins_[by_row_.front()][1];
  patches_.resize(origins_.size() * side * side);
}

void PatchCutter::Push(const uint8_t* rows, int64_t count) {
  for (int64_t i = 0; i < count && !Done(); ++i, rows += photograph_.RowBytes()) {
    CutRow(rows, next_row_++);
  }
}

void PatchCutter::CutRow(const uint8_t* row, int64_t y) {
  while (begun_ < by_row_.size() && origins_[by_row_[begun_]][1] <= y) {
    open_.push_back(by_row_[begun_++]);
  }
  const auto ended = [&](size_t i) { return origins_[i][1] + side_ <= y; };
  open_.erase(std::remove_if(open_.begin(), open_.end(), ended), open_.end());
  for (const size_t i : open_) {
    const auto [x0, y0] = origins_[i];
    const uint8_t* pixels = row + x0 * photograph_.PixelBytes();
    uint16_t* luma = &patches_[(i * side_ + (y - y0)) * side_];
    if (photograph_.sample_bytes == 1) {
      ToLuma(pixels, photograph_.channels, side_, luma);
    } else {
      ToLuma(reinterpret_cast<const uint16_t*>(pixels), photograph_.channels, side_, luma);
    }
  }
}

std::vector<uint16_t> PatchCutter::TakePatches() {
  if (!Done()) throw std::logic_error("rows of the photograph are missing");
  return std::move(patches_);
}

void CutPatches(ImageReader& photograph, PatchCutter& cutter) {
  if (!(photograph.shape() == cutter.photograph())) {
    throw InputError("a photograph has changed while it was worked on: run again");
  }
  std::vector<uint8_t> rows(kRows * photograph.shape().RowBytes());
  photograph.SkipRows(cutter.first_row());
  int64_t y = cutter.first_row();
  for (; y < cutter.end_row(); y += kRows) {
    const int64_t count = std::min(kRows, cutter.end_row() - y);
    photograph.ReadRows(count, rows.data());
    cutter.Push(rows.data(), count);
  }
}

}  // namespace sirpy
