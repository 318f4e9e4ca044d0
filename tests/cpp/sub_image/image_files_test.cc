// Writers, readers and windows of every format.
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "error.h"
#include "rows.h"
#include "sub_image/image_reader.h"
#include "sub_image/image_writer.h"
#include "sub_image/read_window.h"
#include "sub_image/recapture.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

class ImageFiles : public ::testing::Test {
 protected:
  ImageFiles()
      : folder_(fs::path(::testing::TempDir()) /
                ::testing::UnitTest::GetInstance()->current_test_info()->name()) {
    fs::remove_all(folder_);
  }
  ~ImageFiles() override { fs::remove_all(folder_); }

  fs::path Write(const char* name, const ImageShape& shape, const std::vector<uint8_t>& pixels) {
    const fs::path path = folder_ / name;
    fs::remove(path);
    const auto writer = OpenImageWriter(path, shape, {});
    for (int64_t y = 0; y < shape.height; ++y) writer->WriteRow(&pixels[y * shape.RowBytes()]);
    EXPECT_FALSE(fs::exists(path)) << "the name is given to whole files only";
    writer->Finish();
    EXPECT_TRUE(fs::exists(path));
    return path;
  }

  static void Truncate(const fs::path& path, double part) {
    fs::resize_file(path, static_cast<uintmax_t>(fs::file_size(path) * part));
  }

  fs::path folder_;
};

std::vector<uint8_t> ReadAll(const fs::path& path) {
  const auto reader = OpenImageReader(path, Bands::kAll);
  std::vector<uint8_t> pixels(reader->shape().RowBytes() * reader->shape().height);
  reader->ReadRows(reader->shape().height, pixels.data());
  reader->Finish();
  return pixels;
}

TEST_F(ImageFiles, PngIsLossless) {
  for (int channels : {1, 2, 3, 4}) {
    for (int sample_bytes : {1, 2}) {
      const ImageShape shape{61, 47, channels, sample_bytes};
      const std::vector<uint8_t> pixels = Noise(shape);
      const fs::path path = Write("a.png", shape, pixels);
      EXPECT_EQ(ReadAll(path), pixels);
      const auto color = OpenImageReader(path, Bands::kColor);
      EXPECT_EQ(color->shape().channels, channels <= 2 ? 1 : 3);
      EXPECT_EQ(color->has_alpha(), channels % 2 == 0);
    }
  }
}

TEST_F(ImageFiles, JpegKeepsTheColourOfEveryPixel) {
  const ImageShape shape{64, 48, 3};
  std::vector<uint8_t> pixels;
  // Red and blue stripes of one pixel: subsampled chroma would mix them to purple.
  for (int64_t i = 0; i < 64 * 48; ++i) {
    for (int value : {i % 2 ? 255 : 0, 0, i % 2 ? 0 : 255}) pixels.push_back(value);
  }
  const std::vector<uint8_t> read = ReadAll(Write("a.jpg", shape, pixels));
  for (size_t i = 0; i < pixels.size(); ++i) ASSERT_NEAR(read[i], pixels[i], 40) << i;
}

TEST_F(ImageFiles, UnfinishedFilesVanish) {
  const ImageShape shape{64, 48, 1};
  for (const char* name : {"a.png", "a.jpg"}) {
    OpenImageWriter(folder_ / name, shape, {})->WriteRow(Noise(shape).data());
  }
  EXPECT_TRUE(fs::is_empty(folder_));
}

TEST_F(ImageFiles, TruncationIsFound) {
  const ImageShape shape{200, 300, 3};
  for (double part : {0.99, 0.5, 0.01, 0.0}) {
    const fs::path jpeg = Write("a.jpg", shape, Noise(shape));
    Truncate(jpeg, part);
    EXPECT_THROW(ReadAll(jpeg), InputError) << part;
    const fs::path png = Write("a.png", shape, Noise(shape));
    Truncate(png, part);
    EXPECT_THROW(ReadAll(png), InputError) << part;
  }
  EXPECT_THROW(OpenImageReader(folder_ / "absent.jpg", Bands::kAll), InputError);
}

TEST_F(ImageFiles, MessagesNameTheFile) {
  const fs::path path = Write("a.jpg", {20, 30, 1}, Noise({20, 30, 1}));
  Truncate(path, 0.5);
  try {
    ReadAll(path);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find(path.string()), std::string::npos);
  }
}

TEST_F(ImageFiles, WindowsArePartsOfTheWhole) {
  const ImageShape shape{61, 47, 3};
  const std::vector<uint8_t> pixels = Noise(shape);
  for (const char* name : {"a.png", "a.jpg"}) {
    const fs::path path = Write(name, shape, pixels);
    const Rectangle part{13, 21, 30, 19};
    const std::vector<uint8_t> whole = ReadWindow(path, {0, 0, 61, 47}, Pixels::kAll, 255).bytes;
    const std::vector<uint8_t> window = ReadWindow(path, part, Pixels::kColor, 255).bytes;
    const std::vector<uint8_t> grey = ReadWindow(path, part, Pixels::kGrey, 255).bytes;
    for (int64_t y = 0; y < 19; ++y) {
      for (int64_t x = 0; x < 30; ++x) {
        const uint8_t* expected = &whole[3 * ((y + 21) * 61 + x + 13)];
        const uint8_t* found = &window[3 * (y * 30 + x)];
        ASSERT_TRUE(std::equal(found, found + 3, expected));
        ASSERT_EQ(grey[y * 30 + x], Luma(expected[0], expected[1], expected[2]));
      }
    }
    EXPECT_THROW(ReadWindow(path, {40, 0, 22, 10}, Pixels::kGrey, 255), InputError);
  }
}

TEST_F(ImageFiles, SixteenBitsShowWhiteAsWhite) {
  const std::vector<uint16_t> pixels = {0, 1000, 2000, 3000, 4000, 65535};
  const auto* bytes = reinterpret_cast<const uint8_t*>(pixels.data());
  const fs::path path = Write("a.png", {6, 1, 1, 2}, {bytes, bytes + 12});
  EXPECT_EQ(ReadWindow(path, {0, 0, 6, 1}, Pixels::kGrey, 4000).bytes,
            (std::vector<uint8_t>{0, 64, 128, 191, 255, 255}));
  EXPECT_EQ(ReadWindow(path, {1, 0, 1, 1}, Pixels::kAll, 4000).bytes,
            (std::vector<uint8_t>{bytes + 2, bytes + 4}));
}

TEST_F(ImageFiles, FormatsRefuseWhatTheyCannotHold) {
  EXPECT_THROW(OpenImageWriter(folder_ / "a.jpg", {4, 4, 1, 2}, {}), std::invalid_argument);
  EXPECT_THROW(OpenImageWriter(folder_ / "a.jpg", {4, 4, 4, 1}, {}), std::invalid_argument);
  EXPECT_THROW(OpenImageWriter(folder_ / "a.png", {4, 4, 5, 1}, {}), std::invalid_argument);
  EXPECT_THROW(OpenImageWriter(folder_ / "a.jpg", {70000, 4, 1, 1}, {}), InputError);
  EXPECT_THROW(OpenImageWriter(folder_ / "a.png", {4, 1000001, 1, 1}, {}), InputError);
  EXPECT_THROW(OpenImageWriter(folder_ / "a.gif", {4, 4, 1, 1}, {}), std::invalid_argument);
}

TEST_F(ImageFiles, ChromaIsSubsampledOnRequest) {
  const ImageShape shape{64, 48, 3};
  WriterOptions options;
  std::vector<uintmax_t> sizes;
  for (JpegChroma chroma : {JpegChroma::k444, JpegChroma::k422, JpegChroma::k420}) {
    options.jpeg_chroma = chroma;
    const auto writer = OpenImageWriter(folder_ / "a.jpg", shape, options);
    const std::vector<uint8_t> pixels = Noise(shape);
    for (int64_t y = 0; y < shape.height; ++y) writer->WriteRow(&pixels[y * shape.RowBytes()]);
    writer->Finish();
    sizes.push_back(fs::file_size(folder_ / "a.jpg"));
  }
  EXPECT_GT(sizes[0], sizes[1]);
  EXPECT_GT(sizes[1], sizes[2]);
}

TEST_F(ImageFiles, OnlyRowsOfTheRectangleAreNeeded) {
  const ImageShape shape{64, 400, 3};
  const std::vector<uint8_t> pixels = Noise(shape);
  RecaptureTask task;
  task.photograph = shape;
  task.width = 64;
  task.height = 400;
  task.in_memory = true;
  task.sub_images = {{"", {10, 100, 7, 30}}};
  Recapture recapture(task);
  EXPECT_EQ(recapture.first_row(), 100);
  for (int64_t y = 100; !recapture.Done(); ++y) recapture.Push(&pixels[y * 192], 1);
  recapture.Finish();
  const std::vector<uint8_t> kept = recapture.TakePixels();
  ASSERT_EQ(kept.size(), 7u * 30 * 3);
  for (int64_t y = 0; y < 30; ++y) {
    ASSERT_TRUE(std::equal(&kept[y * 21], &kept[y * 21] + 21, &pixels[(y + 100) * 192 + 30]));
  }
}

TEST(Luma, KeepsGrey) {
  for (int grey = 0; grey < 256; ++grey) EXPECT_EQ(Luma(grey, grey, grey), grey);
}

TEST_F(ImageFiles, RecaptureOfAPartialPhotographLeavesWholeFilesOnly) {
  const ImageShape shape{40, 200, 1};
  const std::vector<uint8_t> pixels = Noise(shape);
  RecaptureTask task;
  task.photograph = shape;
  task.width = 40;
  task.height = 200;
  task.sub_images = {{folder_ / "upper.png", {0, 0, 25, 90}},
                     {folder_ / "lower.png", {10, 80, 30, 120}}};
  {
    Recapture recapture(task);
    recapture.Push(pixels.data(), 150);
    EXPECT_THROW(recapture.Finish(), std::logic_error);
  }
  ASSERT_EQ(std::distance(fs::directory_iterator(folder_), {}), 1);
  const std::vector<uint8_t> upper = ReadAll(folder_ / "upper.png");
  for (int64_t y = 0; y < 90; ++y) {
    ASSERT_TRUE(std::equal(&upper[y * 25], &upper[y * 25] + 25, &pixels[y * 40]));
  }
}

TEST_F(ImageFiles, SubImagesBeyondTheImageAreRefused) {
  RecaptureTask task;
  task.photograph = {40, 20, 1};
  task.width = 40;
  task.height = 20;
  task.sub_images = {{folder_ / "a.png", {30, 0, 11, 20}}};
  EXPECT_THROW(Recapture{task}, std::invalid_argument);
}

}  // namespace
}  // namespace sirpy
