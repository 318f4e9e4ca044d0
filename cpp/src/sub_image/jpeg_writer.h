// JPEG; by default without chroma subsampling (4:4:4), so that the colour of a pixel never mixes
// with its neighbours'.
#pragma once

#include <memory>

#include "sub_image/image_writer.h"

namespace sirpy {

class JpegWriter : public ImageWriter {
 public:
  JpegWriter(const std::filesystem::path& path, const ImageShape& shape,
             const WriterOptions& options);
  ~JpegWriter() override;

  void WriteRow(const uint8_t* row) override;
  void Finish() override;

 private:
  struct Encoder;
  std::unique_ptr<Encoder> encoder_;
};

}  // namespace sirpy
