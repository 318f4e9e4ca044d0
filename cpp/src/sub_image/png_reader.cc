#include "sub_image/png_reader.h"

#include <png.h>

#include <cerrno>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <new>
#include <string>
#include <vector>

#include "error.h"

namespace sirpy {

struct PngReader::Decoder {
  explicit Decoder(const std::filesystem::path& path)
      : name(path.string()), file(std::fopen(path.c_str(), "rb")) {
    if (file == nullptr)
      throw InputError("cannot open image " + name + ": " + std::strerror(errno));
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
      throw InputError("image " + name + " is damaged (" + message +
                       "): delete it and run the same command again");
    }
    call();
  }

  std::string name;
  std::FILE* file;
  png_structp png = nullptr;
  png_infop info = nullptr;
  char message[128] = {};
};

PngReader::PngReader(const std::filesystem::path& path)
    : decoder_(std::make_unique<Decoder>(path)) {
  png_structp png = decoder_->png;
  png_infop info = decoder_->info;
  decoder_->Guard([png, info, file = decoder_->file] {
    png_init_io(png, file);
    png_read_info(png, info);
  });
  const int channels = png_get_channels(png, info);
  if (png_get_bit_depth(png, info) != 8 || (channels != 1 && channels != 3) ||
      png_get_color_type(png, info) == PNG_COLOR_TYPE_PALETTE ||
      png_get_interlace_type(png, info) != PNG_INTERLACE_NONE) {
    throw InputError("image " + decoder_->name +
                     " is not a PNG of 8-bit grey or RGB without interlacing: convert it");
  }
  shape_ = {static_cast<int64_t>(png_get_image_width(png, info)),
            static_cast<int64_t>(png_get_image_height(png, info)), channels};
}

PngReader::~PngReader() = default;

void PngReader::ReadRows(int64_t count, uint8_t* rows) {
  decoder_->Guard([png = decoder_->png, count, rows, bytes = shape_.RowBytes()] {
    for (int64_t row = 0; row < count; ++row) png_read_row(png, rows + row * bytes, nullptr);
  });
}

void PngReader::SkipRows(int64_t count) {
  std::vector<uint8_t> row(shape_.RowBytes());
  for (; count > 0; --count) ReadRows(1, row.data());
}

}  // namespace sirpy
