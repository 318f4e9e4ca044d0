// Shrinks rows as they come by the area average: an output pixel is the mean of the input pixels
// under its footprint, each weighted by the area that is under it (8 or 16 bit). In integers, so it
// is exact but for the last rounding. Output pixel i covers [i * N / n, (i + 1) * N / n) of N input
// pixels.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "sub_image/image_shape.h"
#include "sub_image/row_sink.h"

namespace sirpy {

class Shrink : public RowSink {
 public:
  // Throws std::invalid_argument when an output side is longer than the input's.
  Shrink(const ImageShape& source, int64_t width, int64_t height, std::unique_ptr<RowSink> next);

  void Push(const uint8_t* rows, int64_t count) override;
  void Finish() override;
  bool Done() const override { return output_row_ == height_; }

 private:
  template <typename Sample>
  void ShrinkRow(const Sample* row, uint64_t* sums) const;
  void AddRow(const uint64_t* sums);
  void Add(const uint64_t* sums, uint64_t weight);
  template <typename Sample>
  void EmitRow();

  ImageShape source_;
  int64_t width_;
  int64_t height_;
  std::unique_ptr<RowSink> next_;
  int64_t input_row_ = 0;
  int64_t output_row_ = 0;
  std::vector<uint64_t> row_sums_;
  std::vector<uint64_t> sums_;
  std::vector<uint8_t> out_;
};

}  // namespace sirpy
