// Undistorts rows as they come. Target pixel centres go through the lens map to positions in the
// photograph, which is read there by bilinear interpolation; positions beyond its outermost pixel
// centres give black (COLMAP's rule). Holds only those source rows that the next band of target
// rows needs: as many as the lens bends a line, plus the band.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sub_image/image_shape.h"
#include "sub_image/lens_map.h"
#include "sub_image/row_sink.h"

namespace sirpy {

class Warp : public RowSink {
 public:
  // source: shape of the photograph, whose rows are pushed; next takes the rows of the undistorted
  // image.
  Warp(std::shared_ptr<const LensMap> lens, const ImageShape& source,
       std::unique_ptr<RowSink> next);

  // Throws InputError when the lens folds so that rows which are gone are needed again.
  void Push(const uint8_t* rows, int64_t count) override;
  void Finish() override;

 private:
  void Keep(const uint8_t* rows, int64_t count);
  void BeginBand();
  bool BandIsReady() const;
  void EmitBand();
  template <int kChannels>
  void WarpRow(const int32_t* x, const int32_t* y, uint8_t* out) const;
  uint8_t* Slot(int64_t source_row) {
    return &kept_[(source_row & (capacity_ - 1)) * source_.RowBytes()];
  }

  std::shared_ptr<const LensMap> lens_;
  ImageShape source_;
  std::unique_ptr<RowSink> next_;

  // Source rows [first_kept_, received_), row r in slot r modulo capacity (a power of two).
  std::vector<uint8_t> kept_;
  int64_t capacity_ = 0;
  int64_t first_kept_ = 0;
  int64_t received_ = 0;

  // Target rows [band_begin_, band_begin_ + band_rows_), their positions in the photograph, and the
  // source rows [band_first_, band_last_] that they need.
  int64_t band_begin_ = 0;
  int64_t band_rows_ = 0;
  int64_t band_first_ = 0;
  int64_t band_last_ = 0;
  std::vector<int32_t> band_x_;
  std::vector<int32_t> band_y_;
  std::vector<uint8_t> band_out_;
};

}  // namespace sirpy
