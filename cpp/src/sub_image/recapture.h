// Sub-image recapture of one photograph (Y. Wang, arXiv 2503.06818): it is undistorted and cut in
// one pass over its rows, top to bottom, and every sub-image is written as the photograph of its
// own camera. Only rows that a sub-image needs are used. Memory grows with the width of the
// photograph, not with its height.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "sub_image/image_reader.h"
#include "sub_image/image_shape.h"
#include "sub_image/interpolation.h"
#include "sub_image/lens_map.h"
#include "sub_image/row_sink.h"
#include "sub_image/sub_image_files.h"

namespace sirpy {

struct RecaptureTask {
  ImageShape photograph;
  std::shared_ptr<const LensMap> lens;  // none: the pixels are copied, not resampled
  Interpolation interpolation = Interpolation::kBilinear;
  int64_t width = 0;   // of the image that is cut; smaller than the undistorted one
  int64_t height = 0;  // where that is to be shrunk
  std::vector<SubImageFile> sub_images;
  WriterOptions writer;
  bool in_memory = false;  // the only sub-image is kept, not written
  int white = 0;           // of 16 bits: written as 8 bit so that this is 255; 0: as they are
};

// Photograph rows go in, sub-image files come out.
class Recapture {
 public:
  // Throws std::invalid_argument when the sizes of the task contradict each other.
  explicit Recapture(RecaptureTask task);

  // The first row of the photograph that is needed; rows before it are not to be pushed.
  int64_t first_row() const { return first_row_; }
  // The row before which, to all appearances, the last that is needed lies.
  int64_t expected_end() const { return expected_end_; }
  // No later row is needed.
  bool Done() const { return rows_->Done(); }

  // The next rows of the photograph, contiguous. Throws InputError, OutputError.
  void Push(const uint8_t* rows, int64_t count);

  // After the last row. Until then what is unfinished has no file; files that are whole stay.
  void Finish();

  const ImageShape& photograph() const { return photograph_; }

  // The sub-image that was kept in memory: its shape, and its rows, contiguous. Once, after the
  // last row; throws std::logic_error otherwise.
  const ImageShape& kept_shape() const { return kept_shape_; }
  std::vector<uint8_t> TakePixels();

 private:
  ImageShape photograph_;
  ImageShape kept_shape_;
  std::vector<uint8_t> pixels_;
  int64_t first_row_ = 0;
  int64_t expected_end_ = 0;
  std::unique_ptr<RowSink> rows_;
  int64_t next_row_ = 0;
};

// All that `recapture` needs of a photograph: a thread decodes rows while those before are worked
// on. Throws InputError when it is damaged or has another shape than the task says.
void RecaptureFrom(ImageReader& photograph, Recapture& recapture);

}  // namespace sirpy
