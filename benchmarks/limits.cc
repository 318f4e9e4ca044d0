// What decoding, warping and encoding a JPEG photograph cost alone, on one thread:
//
//   limits PHOTOGRAPH.jpg OUTPUT_FOLDER QUALITY CHROMA
//
// prints {"decode": CPU seconds, "warp": ..., "encode": ...} for all of the photograph's pixels.
// Nothing is kept: no recapture of a photograph can be cheaper than the sum, with these libraries
// and kernels.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sub_image/image_reader.h"
#include "sub_image/image_writer.h"
#include "sub_image/lens_map.h"
#include "sub_image/warp.h"

namespace sirpy {
namespace {

constexpr int64_t kRows = 512;

double CpuSeconds() {
  timespec now;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

class Nowhere : public RowSink {
 public:
  void Push(const uint8_t* /*rows*/, int64_t /*count*/) override {}
  void Finish() override {}
  bool Done() const override { return false; }
};

// A pinhole image of a lens with a few per cent of distortion, by third-order polynomials.
std::shared_ptr<const LensMap> BentLens(const ImageShape& shape) {
  constexpr int kNodes = 64;
  std::vector<double> nodes;
  for (int row = 0; row < kNodes; ++row) {
    for (int column = 0; column < kNodes; ++column) {
      const double x = (column / (kNodes - 1.0) - 0.5) * shape.width;
      const double y = (row / (kNodes - 1.0) - 0.5) * shape.height;
      const double radius = (x * x + y * y) / (static_cast<double>(shape.width) * shape.width);
      const double scale = 1 - 0.04 * radius;
      nodes.push_back(shape.width / 2.0 + scale * x);
      nodes.push_back(shape.height / 2.0 + scale * y);
    }
  }
  return std::make_shared<LensMap>(nodes, kNodes, kNodes, shape.width, shape.height);
}

int Main(const std::filesystem::path& path, const std::filesystem::path& folder,
         const WriterOptions& options) {
  options.Validate();
  const double begin = CpuSeconds();
  const auto reader = OpenImageReader(path, Bands::kColor);
  const ImageShape shape = reader->shape();
  std::vector<uint8_t> rows(kRows * shape.RowBytes());
  for (int64_t y = 0; y < shape.height; y += kRows) {
    reader->ReadRows(std::min(kRows, shape.height - y), rows.data());
  }
  const double decoded = CpuSeconds();

  Warp warp(BentLens(shape), {0, 0, shape.width, shape.height}, shape, Interpolation::kBilinear,
            std::make_unique<Nowhere>());
  for (int64_t y = warp.first_row(); !warp.Done() && y < shape.height; ++y) {
    warp.Push(&rows[(y % kRows) * shape.RowBytes()], 1);
  }
  const double warped = CpuSeconds();

  const auto writer = OpenImageWriter(folder / "limits.jpg", shape, options);
  for (int64_t y = 0; y < shape.height; ++y) {
    writer->WriteRow(&rows[(y % kRows) * shape.RowBytes()]);
  }
  writer->Finish();
  const double encoded = CpuSeconds();
  std::printf("{\"decode\": %.2f, \"warp\": %.2f, \"encode\": %.2f}\n", decoded - begin,
              warped - decoded, encoded - warped);
  return 0;
}

}  // namespace
}  // namespace sirpy

int main(int count, char** arguments) {
  using sirpy::JpegChroma;
  const std::map<std::string, JpegChroma> chromas = {
      {"444", JpegChroma::k444}, {"422", JpegChroma::k422}, {"420", JpegChroma::k420}};
  if (count != 5 || chromas.count(arguments[4]) == 0) {
    std::fprintf(stderr, "limits PHOTOGRAPH.jpg OUTPUT_FOLDER QUALITY 444|422|420\n");
    return 2;
  }
  sirpy::WriterOptions options;
  options.jpeg_quality = std::stoi(arguments[3]);
  options.jpeg_chroma = chromas.at(arguments[4]);
  return sirpy::Main(arguments[1], arguments[2], options);
}
