#include "sub_image/png_writer.h"

#include <png.h>

#include <cerrno>
#include <csetjmp>
#include <cstdio>
#include <new>
#include <stdexcept>
#include <string>

#include "sub_image/partial_file.h"

namespace sirpy {
namespace {

constexpr int kColorTypes[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA, PNG_COLOR_TYPE_RGB,
                               PNG_COLOR_TYPE_RGB_ALPHA};

}  // namespace

struct PngWriter::Encoder {
  explicit Encoder(const std::filesystem::path& path)
      : file(path), png(png_create_write_struct(PNG_LIBPNG_VER_STRING, this, OnError, OnWarning)) {
    if (png != nullptr) info = png_create_info_struct(png);
    if (info == nullptr) throw std::bad_alloc();
  }
  ~Encoder() { png_destroy_write_struct(&png, &info); }

  [[noreturn]] static void OnError(png_structp png, png_const_charp message) {
    auto* encoder = static_cast<Encoder*>(png_get_error_ptr(png));
    std::snprintf(encoder->message, sizeof encoder->message, "%s", message);
    png_longjmp(png, 1);
  }
  static void OnWarning(png_structp, png_const_charp) {}

  template <typename Call>
  void Guard(Call call) {
    errno = 0;
    if (setjmp(png_jmpbuf(png)) != 0) {
      if (errno != 0 || std::ferror(file.stream()) != 0) file.Fail();
      throw std::logic_error(std::string("libpng: ") + message);
    }
    call();
  }

  PartialFile file;
  char message[128] = {};
  png_structp png = nullptr;
  png_infop info = nullptr;
};

PngWriter::PngWriter(const std::filesystem::path& path, const ImageShape& shape)
    : encoder_(std::make_unique<Encoder>(path)) {
  encoder_->Guard([encoder = encoder_.get(), &shape] {
    png_structp png = encoder->png;
    png_init_io(png, encoder->file.stream());
    png_set_IHDR(png, encoder->info, static_cast<png_uint_32>(shape.width),
                 static_cast<png_uint_32>(shape.height), 8 * shape.sample_bytes,
                 kColorTypes[shape.channels - 1], PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_compression_level(png, 1);
    png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_write_info(png, encoder->info);
    if (shape.sample_bytes == 2) png_set_swap(png);  // stored big-endian
  });
}

PngWriter::~PngWriter() = default;

void PngWriter::WriteRow(const uint8_t* row) {
  encoder_->Guard([encoder = encoder_.get(), row] { png_write_row(encoder->png, row); });
}

void PngWriter::Finish() {
  encoder_->Guard([encoder = encoder_.get()] { png_write_end(encoder->png, encoder->info); });
  encoder_->file.Commit();
}

}  // namespace sirpy
