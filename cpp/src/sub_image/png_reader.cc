#include "sub_image/png_reader.h"

#include <png.h>

#include <cerrno>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <new>
#include <string>

#include "error.h"

namespace sirpy {

struct PngReader::Decoder {
  explicit Decoder(const std::filesystem::path& path)
      : name(path.string()), file(std::fopen(path.c_str(), "rb")) {
    if (file == nullptr)
      throw InputError("cannot open photograph " + name + ": " + std::strerror(errno));
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, this, OnError, OnWarning);
    if (png != nullptr) info = png_create_info_struct(png);
    if (info == nullptr) throw std::bad_alloc();
  }
  ~Decoder() {
    png_destroy_read_struct(&png, &info, nullptr);
    std::fclose(file);
  }

  [[noreturn]] static void OnError(png_structp png, png_const_charp message) {
    auto* decoder = static_cast<Decoder*>(png_get_error_ptr(png));
    std::snprintf(decoder->message, sizeof decoder->message, "%s", message);
    png_longjmp(png, 1);
  }
  static void OnWarning(png_structp, png_const_charp) {}

  template <typename Call>
  void Guard(Call call) {
    if (setjmp(png_jmpbuf(png)) != 0) {
      throw InputError("photograph " + name + " is damaged (" + message +
                       "): replace it by a good copy, or take it out of the folder");
    }
    call();
  }

  std::string name;
  std::FILE* file;
  png_structp png = nullptr;
  png_infop info = nullptr;
  char message[128] = {};
};

PngReader::PngReader(const std::filesystem::path& path, Bands bands)
    : decoder_(std::make_unique<Decoder>(path)) {
  png_structp png = decoder_->png;
  png_infop info = decoder_->info;
  decoder_->Guard([png, info, file = decoder_->file] {
    png_init_io(png, file);
    png_read_info(png, info);
  });
  const int color_type = png_get_color_type(png, info);
  has_alpha_ = (color_type & PNG_COLOR_MASK_ALPHA) != 0 ||
               (color_type == PNG_COLOR_TYPE_PALETTE && png_get_valid(png, info, PNG_INFO_tRNS));
  if (png_get_interlace_type(png, info) != PNG_INTERLACE_NONE) {
    throw InputError("photograph " + decoder_->name +
                     " is an interlaced PNG: save it without interlacing");
  }
  decoder_->Guard([png, info, bands] {
    if (png_get_color_type(png, info) == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
    if (png_get_bit_depth(png, info) < 8) png_set_expand_gray_1_2_4_to_8(png);
    if (png_get_bit_depth(png, info) == 16) png_set_swap(png);  // stored big-endian
    if (bands == Bands::kColor) png_set_strip_alpha(png);
    png_read_update_info(png, info);
  });
  shape_ = {static_cast<int64_t>(png_get_image_width(png, info)),
            static_cast<int64_t>(png_get_image_height(png, info)), png_get_channels(png, info),
            png_get_bit_depth(png, info) / 8};
  // Deflate makes at most 1032 bytes of one, and bits may be packed eight to a byte.
  CheckFileHolds(path, shape_.width * shape_.height / (8 * 1032));
}

PngReader::~PngReader() = default;

void PngReader::ReadRows(int64_t count, uint8_t* rows) {
  decoder_->Guard([png = decoder_->png, count, rows, bytes = shape_.RowBytes()] {
    for (int64_t row = 0; row < count; ++row) png_read_row(png, rows + row * bytes, nullptr);
  });
}

void PngReader::Finish() {
  decoder_->Guard([decoder = decoder_.get()] { png_read_end(decoder->png, nullptr); });
}

}  // namespace sirpy
