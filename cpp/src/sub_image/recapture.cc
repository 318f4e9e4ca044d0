#include "sub_image/recapture.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "error.h"
#include "sub_image/jpeg_reader.h"
#include "sub_image/png_reader.h"
#include "sub_image/shrink.h"
#include "sub_image/warp.h"

namespace sirpy {
namespace {

constexpr int64_t kBlockRows = 64;

template <typename Reader>
void RecaptureAll(Reader& photograph, RecaptureTask task) {
  const ImageShape shape = photograph.shape();
  if (shape.width != task.photograph.width || shape.height != task.photograph.height ||
      shape.channels != task.photograph.channels) {
    throw InputError("a photograph has changed while it was read: run the same command again");
  }
  Recapture recapture(std::move(task));
  std::vector<uint8_t> rows(kBlockRows * shape.RowBytes());
  for (int64_t row = 0; row < shape.height; row += kBlockRows) {
    const int64_t count = std::min(kBlockRows, shape.height - row);
    photograph.ReadRows(count, rows.data());
    recapture.Push(rows.data(), count);
  }
  photograph.Finish();
  recapture.Finish();
}

// photograph -> warp -> shrink -> files, without the steps that have nothing to do.
std::unique_ptr<RowSink> BuildChain(RecaptureTask task) {
  const int channels = task.photograph.channels;
  const ImageShape cut{task.width, task.height, channels};
  ImageShape undistorted = task.photograph;
  if (task.lens) undistorted = {task.lens->width(), task.lens->height(), channels};

  std::unique_ptr<RowSink> chain =
      std::make_unique<SubImageFiles>(cut, std::move(task.sub_images), task.writer);
  if (cut.width != undistorted.width || cut.height != undistorted.height) {
    chain = std::make_unique<Shrink>(undistorted, cut.width, cut.height, std::move(chain));
  }
  if (task.lens) {
    chain = std::make_unique<Warp>(std::move(task.lens), task.photograph, std::move(chain));
  }
  return chain;
}

}  // namespace

Recapture::Recapture(RecaptureTask task)
    : photograph_(task.photograph), rows_(BuildChain(std::move(task))) {}

void Recapture::Push(const uint8_t* rows, int64_t count) {
  received_ += count;
  if (received_ > photograph_.height) throw std::logic_error("more rows than the photograph has");
  rows_->Push(rows, count);
}

void Recapture::Finish() {
  if (received_ != photograph_.height) throw std::logic_error("rows of the photograph are missing");
  rows_->Finish();
}

void RecaptureJpeg(const std::filesystem::path& path, RecaptureTask task) {
  JpegReader photograph(path);
  RecaptureAll(photograph, std::move(task));
}

void RecapturePng(const std::filesystem::path& path, RecaptureTask task) {
  PngReader photograph(path);
  RecaptureAll(photograph, std::move(task));
}

}  // namespace sirpy
