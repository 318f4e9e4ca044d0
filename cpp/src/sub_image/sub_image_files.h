// Cuts the rows of an image into the files of its sub-images as they come. A sub-image is a
// rectangle of whole pixels of the image; rectangles may overlap, and need not cover it.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "rectangle.h"
#include "sub_image/image_shape.h"
#include "sub_image/image_writer.h"
#include "sub_image/row_sink.h"

namespace sirpy {

struct SubImageFile {
  std::filesystem::path path;  // .jpg, .png or .tif
  Rectangle stored;            // the pixels in the file
};

// The smallest rectangle around what the files store.
Rectangle BoundingBox(const std::vector<SubImageFile>& files);

class SubImageFiles : public RowSink {
 public:
  // window: the part of the image whose rows are pushed; pixel: shape of its pixels. Throws
  // std::invalid_argument when a rectangle is empty or reaches beyond the window.
  SubImageFiles(const Rectangle& window, const ImageShape& pixel, std::vector<SubImageFile> files,
                const WriterOptions& options);

  // Rows after the last that a file needs are passed over. Throws OutputError.
  void Push(const uint8_t* rows, int64_t count) override;
  // Throws std::logic_error when rows are missing.
  void Finish() override;
  bool Done() const override { return next_row_ >= last_row_; }

 private:
  void WriteRows(size_t file, const uint8_t* rows, int64_t count);

  Rectangle window_;
  ImageShape pixel_;
  std::vector<SubImageFile> files_;
  WriterOptions options_;
  std::vector<std::unique_ptr<ImageWriter>> writers_;  // open while their rows come
  int64_t next_row_;                                   // of the image
  int64_t last_row_;                                   // before which all files end
};

}  // namespace sirpy
