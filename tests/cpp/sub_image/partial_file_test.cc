#include "sub_image/partial_file.h"

#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "error.h"
#include "models.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

TEST(TemporaryPath, IsHiddenNamesTheProcessAndKeepsTheExtension) {
  EXPECT_EQ(TemporaryPath("deep/a.b.jpg"),
            fs::path("deep/.a.b." + std::to_string(getpid()) + ".tmp.jpg"));
  EXPECT_EQ(TemporaryPath("model"), fs::path(".model." + std::to_string(getpid()) + ".tmp"));
}

TEST(TemporaryPath, LongNamesAreShortenedAndStayApart) {
  const std::string end = "." + std::to_string(getpid()) + ".tmp.png";
  for (const std::string letter : {"n", "ä", "万"}) {
    std::string stem;
    while (stem.size() + letter.size() < 250) stem += letter;
    const std::string first = TemporaryPath(stem + "1.png").string();
    const std::string second = TemporaryPath(stem + "2.png").string();
    EXPECT_NE(first, second);
    EXPECT_LE(first.size(), 255u);
    EXPECT_GT(first.size(), 255u - letter.size());
    EXPECT_EQ(first.substr(first.size() - end.size()), end);
    const size_t mark = first.find('-');
    EXPECT_EQ(first.substr(0, mark), "." + stem.substr(0, mark - 1));
    EXPECT_EQ((mark - 1) % letter.size(), 0u) << "half a character";
  }
}

TEST(PartialFile, NamesAsLongAsTheFileSystemTakes) {
  const fs::path folder = fs::path(testing::TempDir()) / ("long-" + std::to_string(getpid()));
  for (size_t length : {240, 251}) {
    const fs::path path = folder / (std::string(length, 'n') + ".jpg");
    PartialFile file(path);
    std::fputs("pixels", file.stream());
    file.Commit();
    EXPECT_EQ(ReadBytes(path), "pixels");
  }
  fs::remove_all(folder);
}

TEST(FailToWrite, AdvisesWhatHelps) {
  const auto message = [](int error) -> std::string {
    try {
      FailToWrite("a.jpg", error);
    } catch (const OutputError& failed) {
      return failed.what();
    }
  };
  const std::string again = ", then run the same command again";
  const std::string space = "; free some space or choose another output folder";
  EXPECT_EQ(message(ENOSPC), "cannot write a.jpg: No space left on device" + space + again);
  EXPECT_EQ(message(EFBIG), "cannot write a.jpg: File too large" + space + again);
  EXPECT_EQ(message(0), "cannot write a.jpg: the disk did not take all of it" + space + again);
  EXPECT_EQ(message(EROFS),
            "cannot write a.jpg: Read-only file system; choose another output folder" + again);
  EXPECT_EQ(message(ENAMETOOLONG), "cannot write a.jpg: File name too long; mend that" + again);
}

}  // namespace
}  // namespace sirpy
