// TIFF, lossless (Deflate with horizontal differences, at the fastest compression): strips of rows,
// 8 or 16 bit, any number of channels. The one format here that names what a fourth channel is.
#pragma once

#include <memory>

#include "sub_image/image_writer.h"

namespace sirpy {

class TiffWriter : public ImageWriter {
 public:
  TiffWriter(const std::filesystem::path& path, const ImageShape& shape,
             const WriterOptions& options);
  ~TiffWriter() override;

  void WriteRow(const uint8_t* row) override;
  void Finish() override;

 private:
  struct Encoder;
  std::unique_ptr<Encoder> encoder_;
};

}  // namespace sirpy
