// PNG, lossless, at the fastest compression: 8 or 16 bit; 2 and 4 channels are with alpha.
#pragma once

#include <memory>

#include "sub_image/image_writer.h"

namespace sirpy {

class PngWriter : public ImageWriter {
 public:
  PngWriter(const std::filesystem::path& path, const ImageShape& shape);
  ~PngWriter() override;

  void WriteRow(const uint8_t* row) override;
  void Finish() override;

 private:
  struct Encoder;
  std::unique_ptr<Encoder> encoder_;
};

}  // namespace sirpy
