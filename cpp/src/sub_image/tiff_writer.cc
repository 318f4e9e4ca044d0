#include "sub_image/tiff_writer.h"

#include <tiffio.h>

#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <memory>
#include <vector>

#include "sub_image/partial_file.h"

namespace sirpy {
namespace {

constexpr uint64_t kLargestClassic = 4'000'000'000;  // bytes; beyond it a TIFF is a BigTIFF

// Failures come back as return values; libtiff would print them too.
int SayNothing(TIFF* /*tiff*/, void* /*data*/, const char* /*module*/, const char* /*format*/,
               va_list /*values*/) {
  return 1;
}

std::FILE* Stream(thandle_t handle) { return static_cast<std::FILE*>(handle); }

tmsize_t Read(thandle_t handle, void* data, tmsize_t size) {
  return static_cast<tmsize_t>(std::fread(data, 1, size, Stream(handle)));
}
tmsize_t Write(thandle_t handle, void* data, tmsize_t size) {
  return static_cast<tmsize_t>(std::fwrite(data, 1, size, Stream(handle)));
}
toff_t Seek(thandle_t handle, toff_t offset, int whence) {
  if (fseeko(Stream(handle), static_cast<off_t>(offset), whence) != 0) return -1;
  return static_cast<toff_t>(ftello(Stream(handle)));
}
int Close(thandle_t /*handle*/) { return 0; }  // PartialFile does
toff_t Size(thandle_t handle) {
  const off_t here = ftello(Stream(handle));
  const toff_t size = Seek(handle, 0, SEEK_END);
  fseeko(Stream(handle), here, SEEK_SET);
  return size;
}

}  // namespace

struct TiffWriter::Encoder {
  explicit Encoder(const std::filesystem::path& path) : file(path) {}
  ~Encoder() {
    if (tiff != nullptr) TIFFClose(tiff);
  }
  void Check(bool done) const {
    if (!done) file.Fail();
  }

  PartialFile file;
  TIFF* tiff = nullptr;
  std::vector<uint8_t> row;  // libtiff differences it in place
  uint32_t next_row = 0;
};

TiffWriter::TiffWriter(const std::filesystem::path& path, const ImageShape& shape,
                       const WriterOptions& options)
    : encoder_(std::make_unique<Encoder>(path)) {
  const bool big = static_cast<uint64_t>(shape.RowBytes()) * shape.height > kLargestClassic;
  const std::unique_ptr<TIFFOpenOptions, decltype(&TIFFOpenOptionsFree)> quietly(
      TIFFOpenOptionsAlloc(), TIFFOpenOptionsFree);
  TIFFOpenOptionsSetErrorHandlerExtR(quietly.get(), SayNothing, nullptr);
  TIFFOpenOptionsSetWarningHandlerExtR(quietly.get(), SayNothing, nullptr);
  TIFF* tiff = TIFFClientOpenExt(path.c_str(), big ? "w8" : "w", encoder_->file.stream(), Read,
                                 Write, Seek, Close, Size, nullptr, nullptr, quietly.get());
  encoder_->tiff = tiff;
  encoder_->Check(tiff != nullptr);
  encoder_->row.resize(shape.RowBytes());
  const bool color = shape.channels >= 3;
  std::vector<uint16_t> extra(shape.channels - (color ? 3 : 1), EXTRASAMPLE_UNSPECIFIED);
  if (!extra.empty() && options.last_is_alpha) extra.back() = EXTRASAMPLE_UNASSALPHA;
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, static_cast<uint32_t>(shape.width));
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, static_cast<uint32_t>(shape.height));
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, static_cast<uint16_t>(shape.channels));
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, static_cast<uint16_t>(8 * shape.sample_bytes));
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, color ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK);
  TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  if (!extra.empty()) {
    TIFFSetField(tiff, TIFFTAG_EXTRASAMPLES, static_cast<uint16_t>(extra.size()), extra.data());
  }
  TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_ADOBE_DEFLATE);
  TIFFSetField(tiff, TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
  TIFFSetField(tiff, TIFFTAG_ZIPQUALITY, 1);
  TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, TIFFDefaultStripSize(tiff, 0));
}

TiffWriter::~TiffWriter() = default;

void TiffWriter::WriteRow(const uint8_t* row) {
  errno = 0;
  encoder_->row.assign(row, row + encoder_->row.size());
  encoder_->Check(
      TIFFWriteScanline(encoder_->tiff, encoder_->row.data(), encoder_->next_row++, 0) == 1);
}

void TiffWriter::Finish() {
  errno = 0;
  encoder_->Check(TIFFWriteDirectory(encoder_->tiff) == 1);
  encoder_->Check(std::ferror(encoder_->file.stream()) == 0);
  TIFFClose(encoder_->tiff);  // writes nothing more
  encoder_->tiff = nullptr;
  encoder_->file.Commit();
}

}  // namespace sirpy
