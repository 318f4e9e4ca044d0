#include "sub_image/jpeg_reader.h"

#include <cerrno>
#include <cstring>
#include <string>

#include "error.h"
#include "sub_image/jpeg_error.h"

namespace sirpy {
namespace {

// libjpeg keeps two bytes for each coefficient of an image that comes in several scans.
double CoefficientBytesPerPixel(const jpeg_decompress_struct& info) {
  double samples = 0;
  for (int component = 0; component < info.num_components; ++component) {
    const jpeg_component_info& plane = info.comp_info[component];
    samples += static_cast<double>(plane.h_samp_factor) * plane.v_samp_factor /
               (info.max_h_samp_factor * info.max_v_samp_factor);
  }
  return sizeof(JCOEF) * samples;
}

}  // namespace

struct JpegReader::Decoder {
  explicit Decoder(const std::filesystem::path& path)
      : name(path.string()), file(std::fopen(path.c_str(), "rb"), &std::fclose) {
    if (file == nullptr) {
      throw InputError("cannot open photograph " + name + ": " + std::strerror(errno));
    }
    info.err = errors.Install();
    Guard([this] { jpeg_create_decompress(&info); });
  }
  ~Decoder() { jpeg_destroy_decompress(&info); }

  template <typename Call>
  void Guard(Call call) {
    GuardJpeg(errors, call, [this] {
      throw InputError("photograph " + name + " is damaged (" + errors.message +
                       "): replace it by a good copy, or take it out of the folder");
    });
  }

  std::string name;
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file;
  JpegErrors errors;
  jpeg_decompress_struct info = {};
  bool started = false;
};

JpegReader::JpegReader(const std::filesystem::path& path)
    : decoder_(std::make_unique<Decoder>(path)) {
  jpeg_decompress_struct* info = &decoder_->info;
  decoder_->Guard([info, file = decoder_->file.get()] {
    jpeg_stdio_src(info, file);
    jpeg_read_header(info, TRUE);
  });
  if (info->num_components != 1 && info->num_components != 3) {
    throw InputError("photograph " + decoder_->name + " has " +
                     std::to_string(info->num_components) +
                     " colour components (CMYK?): convert it to RGB or grey");
  }
  info->out_color_space = info->num_components == 3 ? JCS_RGB : JCS_GRAYSCALE;
  shape_ = {static_cast<int64_t>(info->image_width), static_cast<int64_t>(info->image_height),
            info->num_components, 1};
  // A Huffman code of a block of 8 x 8 pixels takes a bit at least.
  if (!info->arith_code) CheckFileHolds(path, shape_.width * shape_.height / (64 * 8));
  if (jpeg_has_multiple_scans(info)) held_bytes_per_pixel_ = CoefficientBytesPerPixel(*info);
}

JpegReader::~JpegReader() = default;

void JpegReader::StartIfNeeded() {
  if (decoder_->started) return;
  decoder_->Guard([decoder = decoder_.get()] { jpeg_start_decompress(&decoder->info); });
  decoder_->started = true;
}

void JpegReader::ReadRows(int64_t count, uint8_t* rows) {
  StartIfNeeded();
  decoder_->Guard([decoder = decoder_.get(), count, rows, bytes = shape_.RowBytes()] {
    for (int64_t row = 0; row < count; ++row) {
      JSAMPROW pointers[1] = {rows + row * bytes};
      jpeg_read_scanlines(&decoder->info, pointers, 1);
    }
  });
}

void JpegReader::SkipRows(int64_t count) {
  StartIfNeeded();
  // With subsampled chroma, rows after a skip may differ from those of a plain read by a grey
  // level.
  if (decoder_->info.max_v_samp_factor == 1) {
    decoder_->Guard([decoder = decoder_.get(), count] {
      jpeg_skip_scanlines(&decoder->info, static_cast<JDIMENSION>(count));
    });
    return;
  }
  ImageReader::SkipRows(count);
}

void JpegReader::Finish() {
  decoder_->Guard([decoder = decoder_.get()] { jpeg_finish_decompress(&decoder->info); });
}

}  // namespace sirpy
