// Reading a PNG row by row through libpng: 8 or 16 bit (in native byte order), grey or RGB; alpha
// only where all bands are asked for. Palettes and fewer bits become 8 bit. An interlaced PNG would
// have to be held whole, so it is refused.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>

#include "sub_image/image_reader.h"

namespace sirpy {

class PngReader : public ImageReader {
 public:
  // Reads the header. Throws InputError when the file is missing, is no PNG, or is interlaced.
  PngReader(const std::filesystem::path& path, Bands bands);
  ~PngReader() override;

  void ReadRows(int64_t count, uint8_t* rows) override;
  void Finish() override;

 private:
  struct Decoder;
  std::unique_ptr<Decoder> decoder_;
};

}  // namespace sirpy
