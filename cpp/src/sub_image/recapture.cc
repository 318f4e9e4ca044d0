#include "sub_image/recapture.h"

#include <algorithm>
#include <future>
#include <stdexcept>
#include <utility>

#include "error.h"
#include "sub_image/read_window.h"
#include "sub_image/shrink.h"
#include "sub_image/warp.h"

namespace sirpy {
namespace {

// Bytes of a block of rows: large enough that the threads seldom wait for each other.
constexpr int64_t kBlockBytes = 2 << 20;

constexpr int64_t kSliceRows = 64;

// Keeps one rectangle of the rows that pass.
class Collect : public RowSink {
 public:
  Collect(const Rectangle& window, const Rectangle& kept, int64_t pixel_bytes,
          std::vector<uint8_t>* pixels)
      : window_(window),
        kept_(kept),
        pixel_bytes_(pixel_bytes),
        next_row_(window.y0),
        pixels_(pixels) {
    if (!window.Contains(kept)) {
      throw std::invalid_argument("the rectangle is not inside its image");
    }
    pixels_->clear();
    pixels_->reserve(kept.Area() * pixel_bytes);
  }
  void Push(const uint8_t* rows, int64_t count) override {
    for (int64_t row = 0; row < count; ++row, ++next_row_) {
      if (next_row_ < kept_.y0 || Done()) continue;
      const uint8_t* first = rows + (row * window_.width + kept_.x0 - window_.x0) * pixel_bytes_;
      pixels_->insert(pixels_->end(), first, first + kept_.width * pixel_bytes_);
    }
  }
  void Finish() override {
    if (!Done()) throw std::logic_error("rows of the image are missing");
  }
  bool Done() const override { return next_row_ >= kept_.y1(); }

 private:
  Rectangle window_, kept_;
  int64_t pixel_bytes_;
  int64_t next_row_;
  std::vector<uint8_t>* pixels_;
};

// Makes 8-bit grey or RGB of 16-bit rows.
class ToBytes : public RowSink {
 public:
  ToBytes(int64_t width, const ImageShape& pixel, int white, std::unique_ptr<RowSink> next)
      : shape_(pixel), white_(white), next_(std::move(next)) {
    shape_.width = width;
  }
  // Of the pixels that come out.
  static ImageShape Shape(ImageShape pixel) {
    return ConvertedShape(pixel, {0, 0, pixel.width, pixel.height}, Kind(pixel));
  }
  void Push(const uint8_t* rows, int64_t count) override {
    out_.resize(count * shape_.width * Shape(shape_).channels);
    ConvertPixels(rows, shape_, count * shape_.width, Kind(shape_), white_, out_.data());
    next_->Push(out_.data(), count);
  }
  void Finish() override { next_->Finish(); }
  bool Done() const override { return next_->Done(); }

 private:
  static Pixels Kind(const ImageShape& pixel) {
    return pixel.channels >= 3 ? Pixels::kColor : Pixels::kGrey;
  }

  ImageShape shape_;
  int white_;
  std::unique_ptr<RowSink> next_;
  std::vector<uint8_t> out_;
};

ImageShape UndistortedShape(const RecaptureTask& task) {
  ImageShape shape = task.photograph;
  if (task.lens) {
    shape.width = task.lens->width();
    shape.height = task.lens->height();
  }
  return shape;
}

bool IsShrunk(const RecaptureTask& task) {
  const ImageShape undistorted = UndistortedShape(task);
  return task.width != undistorted.width || task.height != undistorted.height;
}

// The part of the image to be cut whose rows are made: no more than the sub-images need, where
// that can be told.
Rectangle Window(const RecaptureTask& task) {
  if (IsShrunk(task)) return {0, 0, task.width, task.height};
  Rectangle window = BoundingBox(task.sub_images);
  if (!Rectangle{0, 0, task.width, task.height}.Contains(window)) {
    throw std::invalid_argument("a sub-image is not inside its image");
  }
  if (!task.lens) {  // whole rows of the photograph pass through
    window.x0 = 0;
    window.width = task.width;
  }
  return window;
}

}  // namespace

// photograph -> warp -> shrink -> 8 bit -> files, without the steps that have nothing to do.
Recapture::Recapture(RecaptureTask task) : photograph_(task.photograph) {
  const Rectangle window = Window(task);
  first_row_ = window.y0;
  expected_end_ = IsShrunk(task) ? photograph_.height : window.y1();
  const bool to_bytes = task.white > 0 && photograph_.sample_bytes == 2;
  const ImageShape pixel = to_bytes ? ToBytes::Shape(photograph_) : photograph_;
  if (task.in_memory) {
    const Rectangle& kept = task.sub_images.at(0).stored;
    kept_shape_ = {kept.width, kept.height, pixel.channels, pixel.sample_bytes};
    rows_ = std::make_unique<Collect>(window, kept, pixel.PixelBytes(), &pixels_);
  } else {
    rows_ = std::make_unique<SubImageFiles>(window, pixel, std::move(task.sub_images), task.writer);
  }
  if (to_bytes) {
    rows_ = std::make_unique<ToBytes>(window.width, photograph_, task.white, std::move(rows_));
  }
  Rectangle undistorted = window;
  if (IsShrunk(task)) {
    const ImageShape shape = UndistortedShape(task);
    undistorted = {0, 0, shape.width, shape.height};
    rows_ = std::make_unique<Shrink>(shape, task.width, task.height, std::move(rows_));
  }
  if (task.lens) {
    auto warp = std::make_unique<Warp>(std::move(task.lens), undistorted, photograph_,
                                       task.interpolation, std::move(rows_));
    first_row_ = warp->first_row();
    expected_end_ = warp->expected_end();
    rows_ = std::move(warp);
  }
  next_row_ = first_row_;
}

void Recapture::Push(const uint8_t* rows, int64_t count) {
  if (next_row_ + count > photograph_.height) {
    throw std::logic_error("more rows than the photograph has");
  }
  // In slices, so that no stage holds more for a caller with tall blocks.
  for (int64_t row = 0; row < count; row += kSliceRows) {
    rows_->Push(rows + row * photograph_.RowBytes(), std::min(kSliceRows, count - row));
  }
  next_row_ += count;
}

void Recapture::Finish() {
  if (!Done()) throw std::logic_error("rows of the photograph are missing");
  rows_->Finish();
}

std::vector<uint8_t> Recapture::TakePixels() {
  if (pixels_.empty() || !Done()) throw std::logic_error("there are no pixels to take");
  return std::move(pixels_);
}

void RecaptureFrom(ImageReader& photograph, Recapture& recapture) {
  const ImageShape shape = photograph.shape();
  if (!(shape == recapture.photograph())) {
    throw InputError(
        "a photograph has changed since its header was read: run the same command "
        "again");
  }
  const int64_t block_rows = std::clamp<int64_t>(kBlockBytes / shape.RowBytes(), 1, shape.height);
  std::vector<uint8_t> ready(block_rows * shape.RowBytes());
  std::vector<uint8_t> coming(ready.size());
  int64_t next_row = recapture.first_row();
  int64_t rows = 0;
  const auto read = [&] {
    const int64_t needed = std::max<int64_t>(recapture.expected_end() - next_row, 1);
    rows = std::min({block_rows, needed, shape.height - next_row});
    return std::async(std::launch::async,
                      [&photograph, &coming, rows] { photograph.ReadRows(rows, coming.data()); });
  };
  photograph.SkipRows(next_row);
  std::future<void> reading;
  while (!recapture.Done() && next_row < shape.height) {
    if (!reading.valid()) reading = read();
    reading.get();
    std::swap(ready, coming);
    const int64_t ready_rows = rows;
    next_row += ready_rows;
    if (next_row < recapture.expected_end()) reading = read();
    recapture.Push(ready.data(), ready_rows);
  }
  if (reading.valid()) {  // rows that nobody needs
    reading.get();
    next_row += rows;
  }
  // At the end of the photograph damage shows that the rows before did not.
  if (next_row == shape.height) photograph.Finish();
  recapture.Finish();
}

}  // namespace sirpy
