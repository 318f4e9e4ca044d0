#include "sub_image/model_writer.h"

#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <cstring>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "error.h"
#include "models.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

template <typename T>
T At(const std::string& bytes, size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

TEST(ModelWriter, TracksFollowFromTheObservations) {
  const fs::path folder = fs::path(testing::TempDir()) / "tracks";
  WriteModel(SmallModel(), folder);
  const std::string points = ReadBytes(folder / "points3D.bin");
  EXPECT_EQ(At<uint64_t>(points, 0), 5u);
  size_t offset = 8;
  // Point j is keypoint j - i of the images i = 0 .. min(j, 2).
  for (uint32_t j = 0; j < 5; ++j) {
    EXPECT_EQ(At<uint64_t>(points, offset), 1000u - j);
    EXPECT_EQ(At<double>(points, offset + 8), j);
    EXPECT_EQ(At<uint8_t>(points, offset + 32), j);
    EXPECT_EQ(At<double>(points, offset + 35), 0.5 * j);
    const auto track = At<uint64_t>(points, offset + 43);
    EXPECT_EQ(track, std::min(j, 2u) + 1);
    offset += 51;
    for (uint32_t i = 0; i < track; ++i, offset += 8) {
      EXPECT_EQ(At<uint32_t>(points, offset), 10 + i);
      EXPECT_EQ(At<uint32_t>(points, offset + 4), j - i);
    }
  }
  EXPECT_EQ(offset, points.size());
  fs::remove_all(folder);
}

TEST(ModelWriter, RigsAndFramesAreTrivial) {
  const fs::path folder = fs::path(testing::TempDir()) / "rigs";
  WriteModel(SmallModel(), folder);
  const std::string rigs = ReadBytes(folder / "rigs.bin");
  ASSERT_EQ(rigs.size(), 8u + 2 * 16);
  EXPECT_EQ(At<uint32_t>(rigs, 8), 4u);
  EXPECT_EQ(At<uint32_t>(rigs, 24), 7u);
  const std::string frames = ReadBytes(folder / "frames.bin");
  ASSERT_EQ(frames.size(), 8u + 3 * 84);
  EXPECT_EQ(At<uint32_t>(frames, 8 + 84), 11u);         // frame
  EXPECT_EQ(At<uint32_t>(frames, 8 + 84 + 4), 7u);      // rig
  EXPECT_EQ(At<double>(frames, 8 + 84 + 8 + 32), 1.0);  // first of the translation
  EXPECT_EQ(At<uint64_t>(frames, 8 + 84 + 76), 11u);    // image
  fs::remove_all(folder);
}

TEST(ModelWriter, SaysWhereItCannotWrite) {
  const fs::path file = fs::path(testing::TempDir()) / "in_the_way";
  WriteBytes(file, "a file");
  for (const fs::path& folder : {file, file / "model"}) {
    try {
      WriteModel(SmallModel(), folder);
      FAIL();
    } catch (const OutputError& error) {
      const std::string expected =
          "cannot write the model " + folder.string() + ": Not a directory";
      EXPECT_EQ(std::string(error.what()).substr(0, expected.size()), expected);
    }
    EXPECT_EQ(ReadBytes(file), "a file");
  }
  fs::remove(file);
}

// The model in a folder, and the names beside it.
class ReplacedModel : public testing::Test {
 protected:
  ReplacedModel() {
    fs::remove_all(root_);
    WriteModel(SmallModel(), folder_);
    before_ = ReadBytes(folder_ / "cameras.bin");
  }
  ~ReplacedModel() override {
    fs::permissions(root_, fs::perms::owner_all);
    fs::remove_all(root_);
  }

  static SparseModel Other() {
    SparseModel model = SmallModel();
    model.cameras[0].width = 200;
    return model;
  }
  bool IsReplaced() const { return ReadBytes(folder_ / "cameras.bin") != before_; }
  bool IsAlone() const { return std::distance(fs::directory_iterator(root_), {}) == 1; }

  void ExpectRefusal(const fs::path& path, const std::string& reason) const {
    try {
      WriteModel(Other(), path);
      ADD_FAILURE() << path;
    } catch (const OutputError& error) {
      EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what();
    }
  }

  const fs::path root_ = fs::path(testing::TempDir()) / "replaced";
  const fs::path folder_ = root_ / "old";
  std::string before_;
};

TEST_F(ReplacedModel, EveryNameOfTheFolderWill) {
  fs::create_directory_symlink(folder_, fs::path(testing::TempDir()) / "link");
  const fs::path link = fs::path(testing::TempDir()) / "link";
  for (const fs::path& path :
       {folder_, folder_ / "", folder_ / ".", root_ / "." / "x" / ".." / "old", link, link / ""}) {
    WriteModel(SmallModel(), folder_);
    ASSERT_FALSE(IsReplaced());
    WriteModel(Other(), path);
    EXPECT_TRUE(IsReplaced()) << path;
    EXPECT_TRUE(IsAlone()) << path;
  }
  EXPECT_TRUE(fs::is_symlink(link));
  fs::remove(link);
  WriteModel(Other(), root_ / "new" / "");
  EXPECT_TRUE(fs::exists(root_ / "new" / "cameras.bin"));
}

TEST_F(ReplacedModel, AnythingElseThanAModelStays) {
  WriteBytes(root_ / "photograph.jpg", "pixels");
  WriteBytes(folder_ / "project.ini", "of COLMAP");
  ExpectRefusal(root_, "it holds ");
  EXPECT_FALSE(IsReplaced());
  EXPECT_EQ(ReadBytes(root_ / "photograph.jpg"), "pixels");
  WriteBytes(folder_ / "notes.txt", "mine");
  ExpectRefusal(folder_, "it holds notes.txt, no part of a model");
  EXPECT_FALSE(IsReplaced());
  fs::remove(folder_ / "notes.txt");

  const fs::path current = fs::current_path();
  fs::current_path(folder_);
  ExpectRefusal(".", "it is the folder that the program runs in");
  ExpectRefusal("", "");
  ExpectRefusal("/", "it is no name of a folder");
  fs::current_path(current);
  EXPECT_FALSE(IsReplaced());
}

TEST_F(ReplacedModel, StaysWhereTheNewOneCannotTakeItsPlace) {
  if (geteuid() == 0) GTEST_SKIP() << "root may write everywhere";
  fs::permissions(root_, fs::perms::owner_read | fs::perms::owner_exec);
  ExpectRefusal(folder_, "Permission denied; choose another output folder");
  EXPECT_FALSE(IsReplaced());
}

TEST_F(ReplacedModel, StaysWhenTheDiskDoesNotTakeAllOfTheNewOne) {
  rlimit before;
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto ended = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit small{300, before.rlim_max};  // bytes: cameras.bin fits, images.bin does not
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  ExpectRefusal(folder_, "File too large; free some space");
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, ended);
  EXPECT_FALSE(IsReplaced());
  EXPECT_TRUE(IsAlone());
}

TEST(ModelWriter, RefusesArraysThatDoNotFitTogether) {
  const fs::path folder = fs::path(testing::TempDir()) / "unfit";
  fs::remove_all(folder);
  SparseModel model = SmallModel();
  model.point[2] = 5;
  EXPECT_THROW(WriteModel(model, folder), std::invalid_argument);
  model = SmallModel();
  model.starts[1] = 10;
  EXPECT_THROW(WriteModel(model, folder), std::invalid_argument);
  model = SmallModel();
  model.xy.pop_back();
  EXPECT_THROW(WriteModel(model, folder), std::invalid_argument);
  EXPECT_FALSE(fs::exists(folder));
}

}  // namespace
}  // namespace sirpy
