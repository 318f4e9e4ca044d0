// Damaged photographs: image_fuzz [--seed S] [--first CASE] [--cases COUNT]
//
// JPEGs (baseline and progressive, grey, full and halved chroma) and PNGs (8 and 16 bit, with and
// without alpha), read as photographs and as windows.
#include "fuzz/mutate.h"

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>
// jpeglib.h needs FILE and size_t before it.
#include <jpeglib.h>

#include "sub_image/image_reader.h"
#include "sub_image/image_writer.h"
#include "sub_image/models.h"
#include "sub_image/read_window.h"
#include "sub_image/recapture.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr ImageShape kSmall{47, 61, 3};
constexpr int64_t kMostPixels = 1 << 22;  // that are read; the camera would refuse another size

std::vector<uint8_t> Waves(const ImageShape& shape) {
  std::vector<uint8_t> bytes(shape.RowBytes() * shape.height);
  for (size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<uint8_t>(i * i / 97 + i % 7);
  return bytes;
}

std::string Written(const fs::path& path, const ImageShape& shape, JpegChroma chroma) {
  WriterOptions options;
  options.jpeg_chroma = chroma;
  const std::vector<uint8_t> pixels = Waves(shape);
  const auto writer = OpenImageWriter(path, shape, options);
  for (int64_t y = 0; y < shape.height; ++y) writer->WriteRow(&pixels[y * shape.RowBytes()]);
  writer->Finish();
  return ReadBytes(path);
}

std::string ProgressiveJpeg() {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* memory = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &memory, &size);
  info.image_width = static_cast<JDIMENSION>(kSmall.width);
  info.image_height = static_cast<JDIMENSION>(kSmall.height);
  info.input_components = 3;
  info.in_color_space = JCS_RGB;
  jpeg_set_defaults(&info);
  jpeg_simple_progression(&info);
  jpeg_start_compress(&info, TRUE);
  std::vector<uint8_t> pixels = Waves(kSmall);
  for (int64_t y = 0; y < kSmall.height; ++y) {
    JSAMPROW row = &pixels[y * kSmall.RowBytes()];
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  std::string bytes(reinterpret_cast<char*>(memory), size);
  jpeg_destroy_compress(&info);
  std::free(memory);
  return bytes;
}

std::shared_ptr<const LensMap> SlightlyTurned(const ImageShape& shape) {
  std::vector<double> nodes;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) {
      const double x = shape.width * column / 3.0;
      const double y = shape.height * row / 3.0;
      nodes.push_back(x + 0.02 * y - 1);
      nodes.push_back(y - 0.01 * x);
    }
  }
  return std::make_shared<LensMap>(nodes, 4, 4, shape.width, shape.height);
}

class DamagedImages {
 public:
  explicit DamagedImages(const fs::path& folder) : path_(folder / "image") {
    fs::create_directories(folder);
    for (JpegChroma chroma : {JpegChroma::k444, JpegChroma::k422, JpegChroma::k420}) {
      samples_.push_back(Written(folder / "a.jpg", kSmall, chroma));
    }
    samples_.push_back(Written(folder / "a.jpg", {40, 30, 1}, JpegChroma::k444));
    samples_.push_back(ProgressiveJpeg());
    for (int sample_bytes : {1, 2}) {
      for (int channels : {1, 2, 3, 4}) {
        const ImageShape shape{31, 29, channels, sample_bytes};
        samples_.push_back(Written(folder / "a.png", shape, JpegChroma::k444));
      }
    }
  }

  void operator()(fuzz::Random& random) {
    fuzz::Mutator mutated(random);
    const std::string& sample = samples_[fuzz::Below(random, samples_.size())];
    const std::string& other = samples_[fuzz::Below(random, samples_.size())];
    WriteBytes(path_, mutated(sample, other));
    const Bands bands = fuzz::Below(random, 2) ? Bands::kAll : Bands::kColor;
    const auto reader = OpenImageReader(path_, bands);
    const ImageShape shape = reader->shape();
    if (shape.width * shape.height > kMostPixels) return;

    RecaptureTask task;
    task.photograph = shape;
    task.width = shape.width;
    task.height = shape.height;
    task.in_memory = true;
    if (fuzz::Below(random, 2)) task.lens = SlightlyTurned(shape);
    task.interpolation = static_cast<Interpolation>(fuzz::Below(random, 4));
    const Rectangle window = Within(random, shape);
    task.sub_images = {{"", window}};
    Recapture recapture(task);
    RecaptureFrom(*reader, recapture);
    ReadWindow(path_, window, static_cast<Pixels>(fuzz::Below(random, 3)), 255);
  }

 private:
  static Rectangle Within(fuzz::Random& random, const ImageShape& shape) {
    Rectangle window;
    window.x0 = static_cast<int64_t>(fuzz::Below(random, shape.width));
    window.y0 = static_cast<int64_t>(fuzz::Below(random, shape.height));
    window.width = 1 + static_cast<int64_t>(fuzz::Below(random, shape.width - window.x0));
    window.height = 1 + static_cast<int64_t>(fuzz::Below(random, shape.height - window.y0));
    return window;
  }

  fs::path path_;
  std::vector<std::string> samples_;
};

}  // namespace
}  // namespace sirpy

int main(int argc, char** argv) {
  const sirpy::fuzz::Options options = sirpy::fuzz::ParseOptions(argc, argv);
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("sirpy-image-fuzz-" + std::to_string(getpid()));
  const int status = sirpy::fuzz::Run(options, sirpy::DamagedImages(folder));
  std::filesystem::remove_all(folder);
  return status;
}
