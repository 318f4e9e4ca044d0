// Reading a JPEG row by row through libjpeg-turbo: 8-bit grey or RGB. A progressive JPEG works, but
// libjpeg then holds all of its coefficients.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_reader.h"

namespace sirpy {

class JpegReader : public ImageReader {
 public:
  // Reads the header. Throws InputError when the file is missing, is no JPEG, or is CMYK.
  explicit JpegReader(const std::filesystem::path& path);
  ~JpegReader() override;

  void ReadRows(int64_t count, uint8_t* rows) override;
  void SkipRows(int64_t count) override;
  void Finish() override;

 private:
  void StartIfNeeded();

  struct Decoder;
  std::unique_ptr<Decoder> decoder_;
};

}  // namespace sirpy
