// Damaged photographs: image_fuzz [--seed S] [--first CASE] [--cases COUNT]
//
// JPEGs (baseline, in one scan and in several, progressive and arithmetic, grey, full and halved
// chroma, CMYK) and PNGs (1 to 16 bit, palettes, alpha, transparent colours, interlaced), read as
// photographs and as windows.
#include "fuzz/mutate.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>
// jpeglib.h needs FILE and size_t before it.
#include <jpeglib.h>
#include <png.h>

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

// A JPEG of kSmall's size as `prepare` would have it, which changes libjpeg's defaults.
template <typename Prepare>
std::string Jpeg(int channels, J_COLOR_SPACE space, Prepare prepare) {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* memory = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &memory, &size);
  info.image_width = static_cast<JDIMENSION>(kSmall.width);
  info.image_height = static_cast<JDIMENSION>(kSmall.height);
  info.input_components = channels;
  info.in_color_space = space;
  jpeg_set_defaults(&info);
  prepare(info);
  jpeg_start_compress(&info, TRUE);
  const ImageShape shape{kSmall.width, kSmall.height, channels};
  std::vector<uint8_t> pixels = Waves(shape);
  for (int64_t y = 0; y < shape.height; ++y) {
    JSAMPROW row = &pixels[y * shape.RowBytes()];
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  std::string bytes(reinterpret_cast<char*>(memory), size);
  jpeg_destroy_compress(&info);
  std::free(memory);
  return bytes;
}

std::vector<std::string> RareJpegs() {
  const auto progressive = [](jpeg_compress_struct& info) { jpeg_simple_progression(&info); };
  // A whole component in each scan: components, first, first and last coefficient, bits.
  static const jpeg_scan_info kScans[] = {
      {1, {0}, 0, 63, 0, 0}, {1, {1}, 0, 63, 0, 0}, {1, {2}, 0, 63, 0, 0}};
  const auto several_scans = [](jpeg_compress_struct& info) {
    info.scan_info = kScans;
    info.num_scans = 3;
  };
  std::vector<std::string> jpegs = {
      Jpeg(3, JCS_RGB, progressive), Jpeg(1, JCS_GRAYSCALE, progressive),
      Jpeg(3, JCS_RGB, several_scans), Jpeg(4, JCS_CMYK, [](jpeg_compress_struct&) {})};
#ifdef C_ARITH_CODING_SUPPORTED
  const auto arithmetic = [](jpeg_compress_struct& info) { info.arith_code = TRUE; };
  jpegs.push_back(Jpeg(3, JCS_RGB, arithmetic));
#endif
  return jpegs;
}

struct RarePng {
  int color_type;
  int bits;
  bool transparent = false;  // a tRNS chunk
  bool interlaced = false;
};

std::string Png(const RarePng& kind) {
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  std::string bytes;
  png_set_write_fn(
      png, &bytes,
      [](png_structp writer, png_bytep data, size_t size) {
        static_cast<std::string*>(png_get_io_ptr(writer))
            ->append(reinterpret_cast<const char*>(data), size);
      },
      nullptr);
  png_set_IHDR(png, info, static_cast<png_uint_32>(kSmall.width),
               static_cast<png_uint_32>(kSmall.height), kind.bits, kind.color_type,
               kind.interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  const int colors = 1 << std::min(kind.bits, 8);
  std::vector<png_color> palette(colors);
  std::vector<png_byte> alphas(colors);
  for (int i = 0; i < colors; ++i) {
    palette[i] = {static_cast<png_byte>(i), static_cast<png_byte>(3 * i), 9};
    alphas[i] = static_cast<png_byte>(255 - i);
  }
  png_color_16 transparent{};
  if (kind.color_type == PNG_COLOR_TYPE_PALETTE) png_set_PLTE(png, info, palette.data(), colors);
  if (kind.transparent) png_set_tRNS(png, info, alphas.data(), colors, &transparent);
  png_write_info(png, info);
  std::vector<uint8_t> pixels = Waves({kSmall.width, kSmall.height, 3, 2});  // or fewer samples
  std::vector<png_bytep> rows;
  for (int64_t y = 0; y < kSmall.height; ++y) rows.push_back(&pixels[y * kSmall.width * 6]);
  png_write_image(png, rows.data());
  png_write_end(png, info);
  png_destroy_write_struct(&png, &info);
  return bytes;
}

std::vector<std::string> RarePngs() {
  std::vector<std::string> pngs;
  for (const int bits : {1, 2, 4, 8}) {
    pngs.push_back(Png({PNG_COLOR_TYPE_GRAY, bits}));
    pngs.push_back(Png({PNG_COLOR_TYPE_GRAY, bits, true}));
    pngs.push_back(Png({PNG_COLOR_TYPE_PALETTE, bits}));
    pngs.push_back(Png({PNG_COLOR_TYPE_PALETTE, bits, true}));
  }
  for (const int bits : {8, 16}) {
    pngs.push_back(Png({PNG_COLOR_TYPE_RGB, bits, true}));
    pngs.push_back(Png({PNG_COLOR_TYPE_RGB, bits, false, true}));
  }
  return pngs;
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
    for (const auto& rare : {RareJpegs(), RarePngs()}) {
      samples_.insert(samples_.end(), rare.begin(), rare.end());
    }
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
