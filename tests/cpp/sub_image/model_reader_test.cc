#include "sub_image/model_reader.h"

#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "error.h"
#include "models.h"
#include "sub_image/model_writer.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

// Offsets in the files of SmallModel().
constexpr size_t kFirstCamera = 8;
constexpr size_t kFirstParameter = kFirstCamera + 24;
constexpr size_t kFirstImage = 8;
constexpr size_t kCameraOfImage = kFirstImage + 4 + 56;
constexpr size_t kName = kCameraOfImage + 4;
constexpr size_t kFirstKeypoint = kName + sizeof("image 0.jpg") + 8;
constexpr size_t kSecondImage = kFirstKeypoint + 5 * 24;
constexpr size_t kFirstPoint = 8;
constexpr size_t kFirstTrack = kFirstPoint + 43 + 8;

bool Says(const std::string& message, const std::string& words) {
  return message.find(words) != std::string::npos;
}

class ModelReader : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(testing::TempDir()) /
              testing::UnitTest::GetInstance()->current_test_info()->name();
    WriteModel(SmallModel(), folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  template <typename T>
  void Change(const char* name, size_t offset, T value) {
    std::string bytes = ReadBytes(folder_ / name);
    ASSERT_LE(offset + sizeof(T), bytes.size());
    std::memcpy(&bytes[offset], &value, sizeof(T));
    WriteBytes(folder_ / name, bytes);
  }

  // What the reader says of the model; empty when it takes it.
  std::string Refusal() const {
    try {
      ReadModel(folder_);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }

  fs::path folder_;
};

TEST_F(ModelReader, GivesBackWhatWasWritten) {
  const SparseModel expected = SmallModel(), model = ReadModel(folder_);
  ASSERT_EQ(model.cameras.size(), expected.cameras.size());
  for (size_t i = 0; i < model.cameras.size(); ++i) {
    EXPECT_EQ(model.cameras[i].id, expected.cameras[i].id);
    EXPECT_EQ(model.cameras[i].model, expected.cameras[i].model);
    EXPECT_EQ(model.cameras[i].width, expected.cameras[i].width);
    EXPECT_EQ(model.cameras[i].height, expected.cameras[i].height);
    EXPECT_EQ(model.cameras[i].parameters, expected.cameras[i].parameters);
  }
  ASSERT_EQ(model.images.size(), expected.images.size());
  for (size_t i = 0; i < model.images.size(); ++i) {
    EXPECT_EQ(model.images[i].id, expected.images[i].id);
    EXPECT_EQ(model.images[i].camera_id, expected.images[i].camera_id);
    EXPECT_EQ(model.images[i].name, expected.images[i].name);
    EXPECT_EQ(model.images[i].pose, expected.images[i].pose);
  }
  EXPECT_EQ(model.point_ids, expected.point_ids);
  EXPECT_EQ(model.xyz, expected.xyz);
  EXPECT_EQ(model.rgb, expected.rgb);
  EXPECT_EQ(model.errors, expected.errors);
  EXPECT_EQ(model.starts, expected.starts);
  EXPECT_EQ(model.xy, expected.xy);
  EXPECT_EQ(model.point, expected.point);
}

TEST_F(ModelReader, LeavesOutKeypointsWithoutAPoint) {
  // Image 0 loses its first observation, and point 1000 that element of its track.
  Change<uint64_t>("images.bin", kFirstKeypoint + 16, std::numeric_limits<uint64_t>::max());
  std::string points = ReadBytes(folder_ / "points3D.bin");
  points[kFirstTrack - 8] = 0;
  points.erase(kFirstTrack, 8);
  WriteBytes(folder_ / "points3D.bin", points);
  const SparseModel model = ReadModel(folder_);
  EXPECT_EQ(model.starts, (std::vector<int64_t>{0, 4, 8, 11}));
  EXPECT_EQ(model.point, (std::vector<int32_t>{1, 2, 3, 4, 1, 2, 3, 4, 2, 3, 4}));
  EXPECT_EQ(model.xy[0], 10);
}

TEST_F(ModelReader, NamesThePlaceOfEveryKindOfDamage) {
  struct Case {
    const char* file;
    size_t offset;
    uint64_t value;
    size_t size;  // bytes of `value`
    const char* message;
  };
  const uint64_t nan = 0x7ff8000000000000;
  const Case cases[] = {
      {"cameras.bin", 0, uint64_t{1} << 60, 8, "names 1152921504606846976 records"},
      {"cameras.bin", kFirstCamera, 7, 4, "camera 7 is there twice"},
      {"cameras.bin", kFirstCamera, 5, 4, "camera 4, which does not exist"},
      {"cameras.bin", kFirstCamera + 4, 16, 4, "no camera model 16"},
      {"cameras.bin", kFirstCamera + 4, 0xffffffff, 4, "no camera model -1"},
      {"cameras.bin", kFirstCamera + 8, 0, 8, "camera 4 has 0x80 pixels"},
      {"cameras.bin", kFirstCamera + 16, uint64_t{1} << 40, 8, "x1099511627776 pixels"},
      {"cameras.bin", kFirstParameter, nan, 8, "camera 4 is not finite"},
      {"images.bin", 0, 2, 8, "bytes too many follow"},
      {"images.bin", 0, 4, 8, "images.bin is damaged (it ends too early)"},
      {"images.bin", kFirstImage, 11, 4, "image 1.jpg is there twice"},
      {"images.bin", kFirstImage + 4, nan, 8, "the pose of image 10 is not finite"},
      {"images.bin", kFirstImage + 36, nan, 8, "the pose of image 10 is not finite"},
      {"images.bin", kCameraOfImage, 77, 4, "image 0.jpg has camera 77, which does not exist"},
      {"images.bin", kName, 0, 1, "image 10 has no name"},
      {"images.bin", kName, '\n', 1, "a name has control characters"},
      {"images.bin", kName, 0xff, 1, "a name is not UTF-8 text"},
      {"images.bin", kName, 0x80c0, 2, "a name is not UTF-8 text"},  // an overlong zero
      {"images.bin", kName + 6, '1', 1, "image 1.jpg is there twice"},
      {"images.bin", kFirstKeypoint - 8, uint64_t{1} << 40, 8, "more than its size holds"},
      {"images.bin", kFirstKeypoint, nan, 8, "an observation of image image 0.jpg is not finite"},
      {"images.bin", kFirstKeypoint + 16, 1, 8, "keypoint 0 of image image 0.jpg, which does not"},
      {"images.bin", kSecondImage, 99, 4, "names image 11, which does not exist"},
      {"points3D.bin", 0, 4, 8, "bytes too many follow"},
      {"points3D.bin", kFirstPoint, 1, 8, "the track of point 1 names keypoint 0"},
      {"points3D.bin", kFirstPoint + 8, nan, 8, "point 1000 is not finite"},
      {"points3D.bin", kFirstTrack - 8, uint64_t{1} << 61, 8, "more than its size holds"},
      {"points3D.bin", kFirstTrack, 77, 4, "the track of point 1000 names image 77"},
      {"points3D.bin", kFirstTrack + 4, 4, 4, "names keypoint 4 of image image 0.jpg, which does"},
      {"points3D.bin", kFirstTrack + 4, 5, 4, "names keypoint 5 of image image 0.jpg, which does"},
      {"rigs.bin", 0, 3, 8, "rigs.bin is damaged (it ends too early)"},
      {"rigs.bin", 12, 0xffffffff, 4, "rigs.bin is damaged"},
      {"frames.bin", 16, nan, 8, "the pose of frame 10 is not finite"},
      {"frames.bin", 72, 0xffffffff, 4, "names 4294967295 records"},
  };
  for (const Case& damage : cases) {
    const std::string good = ReadBytes(folder_ / damage.file);
    std::string bytes = good;
    std::memcpy(&bytes[damage.offset], &damage.value, damage.size);
    WriteBytes(folder_ / damage.file, bytes);
    EXPECT_PRED2(Says, Refusal(), damage.message) << damage.file << " at " << damage.offset;
    WriteBytes(folder_ / damage.file, good);
  }
  EXPECT_EQ(Refusal(), "");
}

TEST_F(ModelReader, HoldsImagesAndTracksAgainstEachOther) {
  std::string points = ReadBytes(folder_ / "points3D.bin");
  points[kFirstTrack - 8] = 0;
  points.erase(kFirstTrack, 8);
  WriteBytes(folder_ / "points3D.bin", points);
  EXPECT_PRED2(Says, Refusal(), "it does not say that image image 0.jpg sees point 1000");
  // The same element twice.
  std::string twice = points;
  twice[kFirstTrack - 8] = 2;
  const std::string element("\x0a\0\0\0\0\0\0\0", 8);
  twice.insert(kFirstTrack, element + element);
  WriteBytes(folder_ / "points3D.bin", twice);
  EXPECT_PRED2(Says, Refusal(), "point 1000 or an element of its track is there twice");
}

TEST_F(ModelReader, RefusesAPointThatIsThereTwice) {
  // A second point 1000 that no image sees.
  std::string points = ReadBytes(folder_ / "points3D.bin");
  std::string twin = points.substr(kFirstPoint, 43) + std::string(8, '\0');
  points[0] = 6;
  WriteBytes(folder_ / "points3D.bin", points + twin);
  EXPECT_PRED2(Says, Refusal(), "point 1000 is there twice");
}

TEST_F(ModelReader, RefusesEveryTruncation) {
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"}) {
    const std::string good = ReadBytes(folder_ / name);
    for (size_t size = 0; size < good.size(); ++size) {
      WriteBytes(folder_ / name, good.substr(0, size));
      EXPECT_PRED2(Says, Refusal(), std::string(name) + " is damaged") << size;
    }
    WriteBytes(folder_ / name, good + '\0');
    EXPECT_PRED2(Says, Refusal(), "1 bytes too many follow");
    WriteBytes(folder_ / name, good);
  }
}

TEST_F(ModelReader, NeedsFilesThatCanBeRead) {
  fs::remove(folder_ / "images.bin");
  EXPECT_PRED2(Says, Refusal(), "images.bin cannot be read (No such file or directory)");
  fs::create_directory(folder_ / "images.bin");
  EXPECT_PRED2(Says, Refusal(), "images.bin cannot be read (Is a directory)");
}

TEST_F(ModelReader, ReadsNamesOfAnyLanguageThatFitAPath) {
  SparseModel model = SmallModel();
  model.images[0].name = "луг/草地 \xf0\x9f\x8c\xbe.jpg";
  WriteModel(model, folder_);
  EXPECT_EQ(ReadModel(folder_).images[0].name, model.images[0].name);
  model.images[0].name = std::string(5000, 'x');
  WriteModel(model, folder_);
  EXPECT_PRED2(Says, Refusal(), "a name is longer than any path");
}

}  // namespace
}  // namespace sirpy
