// Photographs of several blocks of rows, so that a block is decoded while that before is worked on.
#include "sub_image/recapture.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "error.h"
#include "rows.h"
#include "sub_image/partial_file.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kWidth = 2100, kHeight = 1700;

std::shared_ptr<const LensMap> Barrel() {
  constexpr int kNodes = 20;
  std::vector<double> nodes;
  for (int row = 0; row < kNodes; ++row) {
    for (int column = 0; column < kNodes; ++column) {
      const double x = (column / (kNodes - 1.0) - 0.5) * kWidth;
      const double y = (row / (kNodes - 1.0) - 0.5) * kHeight;
      const double scale = 1 - 0.1 * (x * x + y * y) / (1.0 * kWidth * kWidth);
      nodes.push_back(kWidth / 2.0 + scale * x);
      nodes.push_back(kHeight / 2.0 + scale * y);
    }
  }
  return std::make_shared<LensMap>(nodes, kNodes, kNodes, kWidth, kHeight);
}

RecaptureTask Whole(const ImageShape& shape) {
  RecaptureTask task;
  task.photograph = shape;
  task.width = shape.width;
  task.height = shape.height;
  return task;
}

// Counts what is asked for; the rows are those of `pixels`, and none come from `damaged_row` on.
class Rows : public ImageReader {
 public:
  Rows(const ImageShape& shape, const std::vector<uint8_t>& pixels) : pixels_(pixels) {
    shape_ = shape;
  }
  void ReadRows(int64_t count, uint8_t* rows) override {
    next_row += count;
    if (next_row > damaged_row) throw InputError("damaged");
    std::copy_n(&pixels_[(next_row - count) * shape_.RowBytes()], count * shape_.RowBytes(), rows);
  }
  void SkipRows(int64_t count) override { next_row += count; }
  void Finish() override { finished = true; }

  int64_t next_row = 0;
  int64_t damaged_row = kHeight;
  bool finished = false;

 private:
  const std::vector<uint8_t>& pixels_;
};

class RecaptureTest : public testing::Test {
 protected:
  ~RecaptureTest() override { fs::remove_all(folder_); }

  fs::path Written(const char* name, const ImageShape& shape) const {
    const std::vector<uint8_t> pixels = Noise(shape);
    const auto writer = OpenImageWriter(folder_ / name, shape, {});
    for (int64_t y = 0; y < shape.height; ++y) writer->WriteRow(&pixels[y * shape.RowBytes()]);
    writer->Finish();
    return folder_ / name;
  }

  int64_t NumFiles() const { return std::distance(fs::directory_iterator(folder_), {}); }

  // Tests run side by side.
  const fs::path folder_ = fs::path(testing::TempDir()) / ("recapture-" + std::to_string(getpid()));
};

const std::vector<std::pair<const char*, ImageShape>> kPhotographs = {
    {"a.jpg", {kWidth, kHeight, 3, 1}},
    {"b.png", {kWidth, kHeight, 1, 1}},
    {"c.png", {kWidth, kHeight, 1, 2}},
};

TEST_F(RecaptureTest, ReadingAheadGivesTheBytesOfReadingBefore) {
  for (const auto& [name, shape] : kPhotographs) {
    const fs::path path = Written(name, shape);
    for (const bool bent : {false, true}) {
      for (const bool shrunk : {false, true}) {
        RecaptureTask task = Whole(shape);
        if (bent) task.lens = Barrel();
        if (shrunk) task.width /= 3, task.height /= 3;
        task.in_memory = true;
        task.sub_images = {
            {"", {task.width / 3, task.height / 4, task.width / 2, task.height / 2}}};
        Recapture ahead(task);
        RecaptureFrom(*OpenImageReader(path, Bands::kAll), ahead);

        Recapture in_turn(task);
        const auto reader = OpenImageReader(path, Bands::kAll);
        reader->SkipRows(in_turn.first_row());
        const auto push = [&, shape = shape](int64_t count) {
          std::vector<uint8_t> rows(count * shape.RowBytes());
          reader->ReadRows(count, rows.data());
          in_turn.Push(rows.data(), count);
        };
        push(in_turn.expected_end() - in_turn.first_row() - 1);
        const bool early = in_turn.Done();
        push(1);
        in_turn.Finish();
        const auto what = testing::Message() << name << " bent " << bent << " shrunk " << shrunk;
        EXPECT_FALSE(early) << "rows that nobody needs: " << what;
        EXPECT_TRUE(ahead.TakePixels() == in_turn.TakePixels()) << what;
      }
    }
  }
}

TEST_F(RecaptureTest, FilesArePartsOfThePhotograph) {
  const ImageShape shape{kWidth, kHeight, 3, 1};
  const std::vector<uint8_t> pixels = Noise(shape);
  for (const int64_t height : {600, 700}) {  // of the sub-images; 700: the last reach the last row
    RecaptureTask task = Whole(shape);
    for (int64_t i = 0; i < 6; ++i) {
      const Rectangle stored{i % 2 * 900, i / 2 * 500, 1200, height};
      task.sub_images.push_back({folder_ / (std::to_string(i) + ".png"), stored});
    }
    Rows photograph(shape, pixels);
    Recapture recapture(task);
    RecaptureFrom(photograph, recapture);
    EXPECT_EQ(photograph.next_row, 1000 + height);
    EXPECT_EQ(photograph.finished, height == 700);
    EXPECT_EQ(NumFiles(), 6);
    for (const SubImageFile& file : task.sub_images) {
      const auto reader = OpenImageReader(file.path, Bands::kAll);
      ASSERT_TRUE(reader->shape() == (ImageShape{1200, height, 3, 1}));
      std::vector<uint8_t> row(3600);
      for (int64_t y = 0; y < height; ++y) {
        reader->ReadRows(1, row.data());
        const int64_t first = ((y + file.stored.y0) * kWidth + file.stored.x0) * 3;
        ASSERT_TRUE(std::equal(row.begin(), row.end(), &pixels[first])) << file.path << " " << y;
      }
    }
  }
}

TEST_F(RecaptureTest, DamageInTheMiddleIsFoundAndLeavesNoFile) {
  for (const auto& [name, shape] : kPhotographs) {
    const fs::path path = Written(name, shape);
    fs::resize_file(path, fs::file_size(path) / 2);
    RecaptureTask task = Whole(shape);
    task.lens = Barrel();
    task.sub_images = {{folder_ / "out" / "a.tif", {0, 0, kWidth, kHeight}}};
    {
      Recapture recapture(task);
      EXPECT_THROW(RecaptureFrom(*OpenImageReader(path, Bands::kAll), recapture), InputError)
          << name;
    }
    EXPECT_TRUE(fs::is_empty(folder_ / "out")) << name;
  }
}

TEST_F(RecaptureTest, FilesThatAreWholeBeforeTheDamageStay) {
  const ImageShape shape{kWidth, kHeight, 3, 1};
  const std::vector<uint8_t> pixels = Noise(shape);
  Rows photograph(shape, pixels);
  photograph.damaged_row = 1500;
  RecaptureTask task = Whole(shape);
  task.sub_images = {{folder_ / "upper.tif", {0, 0, 300, 400}},
                     {folder_ / "lower.tif", {0, 1000, 300, 700}}};
  {
    Recapture recapture(task);
    EXPECT_THROW(RecaptureFrom(photograph, recapture), InputError);
  }
  EXPECT_TRUE(fs::exists(folder_ / "upper.tif"));
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(RecaptureTest, AnOutputThatFailsWaitsForTheRowsUnderWay) {
  const ImageShape shape{kWidth, kHeight, 3, 1};
  const std::vector<uint8_t> pixels = Noise(shape);
  const fs::path file = folder_ / "file";
  PartialFile(file).Commit();
  Rows photograph(shape, pixels);
  RecaptureTask task = Whole(shape);
  task.sub_images = {{folder_ / "a.tif", {0, 0, 300, kHeight}},
                     {file / "b.tif", {0, 500, 300, 700}}};
  {
    Recapture recapture(task);
    EXPECT_THROW(RecaptureFrom(photograph, recapture), OutputError);
  }
  EXPECT_GT(photograph.next_row, 500);
  EXPECT_LT(photograph.next_row, kHeight);
  EXPECT_EQ(NumFiles(), 1);
}

TEST_F(RecaptureTest, APhotographThatHasChangedIsRefused) {
  const ImageShape shape{kWidth, kHeight, 1, 1};
  const std::vector<uint8_t> pixels = Noise(shape);
  Rows photograph(shape, pixels);
  RecaptureTask task = Whole({kWidth, kHeight - 1, 1, 1});
  task.in_memory = true;
  task.sub_images = {{"", {0, 0, 10, 10}}};
  Recapture recapture(task);
  EXPECT_THROW(RecaptureFrom(photograph, recapture), InputError);
}

}  // namespace
}  // namespace sirpy
