#include "sub_image/jpeg_writer.h"

#include <cerrno>
#include <stdexcept>
#include <string>

#include "sub_image/jpeg_error.h"
#include "sub_image/partial_file.h"

namespace sirpy {

struct JpegWriter::Encoder {
  explicit Encoder(const std::filesystem::path& path) : file(path) {
    info.err = errors.Install();
    Guard([this] { jpeg_create_compress(&info); });
  }
  ~Encoder() { jpeg_destroy_compress(&info); }

  template <typename Call>
  void Guard(Call call) {
    errno = 0;
    GuardJpeg(errors, call, [this] {
      if (errors.manager.msg_code == JERR_FILE_WRITE) file.Fail();
      throw std::logic_error(std::string("libjpeg: ") + errors.message);
    });
  }

  PartialFile file;
  JpegErrors errors;
  jpeg_compress_struct info = {};
};

JpegWriter::JpegWriter(const std::filesystem::path& path, const ImageShape& shape,
                       const WriterOptions& options)
    : encoder_(std::make_unique<Encoder>(path)) {
  encoder_->Guard([encoder = encoder_.get(), &shape, &options] {
    jpeg_compress_struct* info = &encoder->info;
    jpeg_stdio_dest(info, encoder->file.stream());
    info->image_width = static_cast<JDIMENSION>(shape.width);
    info->image_height = static_cast<JDIMENSION>(shape.height);
    info->input_components = shape.channels;
    info->in_color_space = shape.channels == 3 ? JCS_RGB : JCS_GRAYSCALE;
    jpeg_set_defaults(info);
    jpeg_set_quality(info, options.jpeg_quality, TRUE);
    for (int component = 0; component < info->num_components; ++component) {
      info->comp_info[component].h_samp_factor = 1;
      info->comp_info[component].v_samp_factor = 1;
    }
    if (info->num_components == 3) {
      info->comp_info[0].h_samp_factor = options.jpeg_chroma == JpegChroma::k444 ? 1 : 2;
      info->comp_info[0].v_samp_factor = options.jpeg_chroma == JpegChroma::k420 ? 2 : 1;
    }
    jpeg_start_compress(info, TRUE);
  });
}

JpegWriter::~JpegWriter() = default;

void JpegWriter::WriteRow(const uint8_t* row) {
  encoder_->Guard([encoder = encoder_.get(), row] {
    // libjpeg asks for a pointer to mutable bytes, and does not change them.
    JSAMPROW rows[1] = {const_cast<JSAMPROW>(row)};
    jpeg_write_scanlines(&encoder->info, rows, 1);
  });
}

void JpegWriter::Finish() {
  encoder_->Guard([encoder = encoder_.get()] { jpeg_finish_compress(&encoder->info); });
  encoder_->file.Commit();
}

}  // namespace sirpy
