// Undistorts rows as they come. Target pixel centres go through the lens map to positions in the
// photograph, which is read there by interpolation; positions beyond its outermost pixel centres
// give black (COLMAP's rule). Holds only those source rows that the next band of target rows needs:
// as many as the lens bends a line, plus the band.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "rectangle.h"
#include "sub_image/image_shape.h"
#include "sub_image/interpolation.h"
#include "sub_image/lens_map.h"
#include "sub_image/row_sink.h"

namespace sirpy {

class Warp : public RowSink {
 public:
  // source: shape of the photograph, whose rows are pushed from first_row() on; window: the part of
  // the undistorted image whose rows `next` takes.
  Warp(std::shared_ptr<const LensMap> lens, const Rectangle& window, const ImageShape& source,
       Interpolation interpolation, std::unique_ptr<RowSink> next);

  // The first row of the photograph that the window needs.
  int64_t first_row() const { return first_row_; }
  // The row before which the last that the window needs lies, unless the lens folds.
  int64_t expected_end() const { return expected_end_; }

  // Throws InputError when the lens folds so that rows which are gone are needed again.
  void Push(const uint8_t* rows, int64_t count) override;
  void Finish() override;
  bool Done() const override { return band_rows_ == 0; }

 private:
  void Keep(const uint8_t* rows, int64_t count);
  void BeginBand();
  void PlaceBand();
  bool BandIsReady() const;
  void EmitBand();
  uint8_t* Slot(int64_t source_row) {
    return &kept_[(source_row & (capacity_ - 1)) * source_.RowBytes()];
  }

  std::shared_ptr<const LensMap> lens_;
  Rectangle window_;
  ImageShape source_;
  Interpolation interpolation_;
  const warp::Kernels& kernels_;
  warp::SampleRow sample_row_;
  int64_t first_row_ = 0;
  int64_t expected_end_ = 0;
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
