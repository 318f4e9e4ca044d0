// Cuts the rows of an image into the files of its sub-images as they come. A sub-image is a
// rectangle of whole pixels of the image; rectangles may overlap.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "rectangle.h"
#include "sub_image/image_writer.h"
#include "sub_image/row_sink.h"

namespace sirpy {

struct SubImageFile {
  std::filesystem::path path;  // .jpg or .png
  Rectangle stored;            // the pixels in the file
};

class SubImageFiles : public RowSink {
 public:
  // Throws std::invalid_argument when a rectangle is empty or reaches beyond the image.
  SubImageFiles(const ImageShape& image, std::vector<SubImageFile> files,
                const WriterOptions& options);

  // Throws OutputError.
  void Push(const uint8_t* rows, int64_t count) override;
  // Throws std::logic_error when rows are missing.
  void Finish() override;

 private:
  void WriteRows(size_t file, const uint8_t* rows, int64_t count);

  ImageShape image_;
  std::vector<SubImageFile> files_;
  WriterOptions options_;
  std::vector<std::unique_ptr<ImageWriter>> writers_;  // open while their rows come
  int64_t next_row_ = 0;
};

}  // namespace sirpy
