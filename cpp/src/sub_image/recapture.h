// Sub-image recapture of one photograph (Y. Wang, arXiv 2503.06818): it is undistorted and cut in
// one pass over its rows, top to bottom, and every sub-image is written as the photograph of its
// own camera. Memory grows with the width of the photograph, not with its height.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "sub_image/image_shape.h"
#include "sub_image/lens_map.h"
#include "sub_image/row_sink.h"
#include "sub_image/sub_image_files.h"

namespace sirpy {

struct RecaptureTask {
  ImageShape photograph;
  std::shared_ptr<const LensMap> lens;  // none: the pixels are copied, not resampled
  int64_t width = 0;   // of the image that is cut; smaller than the undistorted one
  int64_t height = 0;  // where that is to be shrunk
  std::vector<SubImageFile> sub_images;
  WriterOptions writer;
};

// Photograph rows go in, sub-image files come out.
class Recapture {
 public:
  // Throws std::invalid_argument when the sizes of the task contradict each other.
  explicit Recapture(RecaptureTask task);

  // The next rows of the photograph, contiguous. Throws InputError, OutputError.
  void Push(const uint8_t* rows, int64_t count);

  // After the last row. Until then what is unfinished has no file; files that are whole stay.
  void Finish();

  const ImageShape& photograph() const { return photograph_; }

 private:
  ImageShape photograph_;
  std::unique_ptr<RowSink> rows_;
  int64_t received_ = 0;
};

// All of a JPEG or PNG. Throw InputError when it is damaged or has another shape than the task
// says.
void RecaptureJpeg(const std::filesystem::path& path, RecaptureTask task);
void RecapturePng(const std::filesystem::path& path, RecaptureTask task);

}  // namespace sirpy
