#include "sub_image/sub_image_files.h"

#include <algorithm>
#include <exception>
#include <stdexcept>
#include <utility>

namespace sirpy {

Rectangle BoundingBox(const std::vector<SubImageFile>& files) {
  if (files.empty()) throw std::invalid_argument("there are no sub-images to cut");
  Rectangle box = files.front().stored;
  for (const SubImageFile& file : files) box = Union(box, file.stored);
  return box;
}

SubImageFiles::SubImageFiles(const Rectangle& window, const ImageShape& pixel,
                             std::vector<SubImageFile> files, const WriterOptions& options)
    : window_(window),
      pixel_(pixel),
      files_(std::move(files)),
      options_(options),
      writers_(files_.size()),
      next_row_(window.y0),
      last_row_(BoundingBox(files_).y1()) {
  options_.Validate();
  for (const SubImageFile& file : files_) {
    const Rectangle& stored = file.stored;
    if (stored.width < 1 || stored.height < 1 || !window_.Contains(stored)) {
      throw std::invalid_argument(file.path.string() + " is not inside its image");
    }
  }
}

void SubImageFiles::Push(const uint8_t* rows, int64_t count) {
  // An exception must not leave a parallel region; the first in order of the files is thrown after
  // it.
  std::vector<std::exception_ptr> failures(files_.size());
#pragma omp parallel for schedule(dynamic)
  for (size_t file = 0; file < files_.size(); ++file) {
    try {
      WriteRows(file, rows, count);
    } catch (...) {
      failures[file] = std::current_exception();
    }
  }
  for (const std::exception_ptr& failure : failures) {
    if (failure) std::rethrow_exception(failure);
  }
  next_row_ += count;
}

void SubImageFiles::WriteRows(size_t file, const uint8_t* rows, int64_t count) {
  const Rectangle& stored = files_[file].stored;
  const int64_t begin = std::max(stored.y0, next_row_);
  const int64_t end = std::min(stored.y1(), next_row_ + count);
  if (begin >= end) return;
  std::unique_ptr<ImageWriter>& writer = writers_[file];
  if (begin == stored.y0) {
    const ImageShape shape{stored.width, stored.height, pixel_.channels, pixel_.sample_bytes};
    writer = OpenImageWriter(files_[file].path, shape, options_);
  }
  for (int64_t row = begin; row < end; ++row) {
    const int64_t pixel = (row - next_row_) * window_.width + (stored.x0 - window_.x0);
    writer->WriteRow(rows + pixel * pixel_.PixelBytes());
  }
  if (end == stored.y1()) {
    writer->Finish();
    writer.reset();
  }
}

void SubImageFiles::Finish() {
  if (!Done()) throw std::logic_error("rows of the image are missing");
}

}  // namespace sirpy
