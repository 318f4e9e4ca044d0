#include "sub_image/partial_file.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <functional>
#include <string>

#include "error.h"

namespace sirpy {
namespace {

namespace fs = std::filesystem;

constexpr size_t kLongestName = 255;  // bytes, of Linux' file systems

// At most `size` bytes of UTF-8, no character in half.
std::string Shortened(const std::string& text, size_t size) {
  while (size > 0 && (text[size] & 0xC0) == 0x80) --size;
  return text.substr(0, size);
}

const char* Remedy(int error) {
  switch (error) {
    case 0:  // what did not take it all gave no reason
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
      return "free some space or choose another output folder, then";
    case EACCES:
    case EPERM:
    case EROFS:
      return "choose another output folder, then";
    default:
      return "mend that, then";
  }
}

}  // namespace

fs::path TemporaryPath(const fs::path& path) {
  std::string stem = path.stem().string();
  const std::string tail = "." + std::to_string(getpid()) + ".tmp" + path.extension().string();
  if (1 + stem.size() + tail.size() > kLongestName) {
    // Names that begin alike stay apart.
    const std::string mark = "-" + std::to_string(std::hash<std::string>{}(stem));
    const size_t taken = std::min(kLongestName, 1 + mark.size() + tail.size());
    stem = Shortened(stem, kLongestName - taken) + mark;
  }
  return path.parent_path() / ("." + stem + tail);
}

void FailToWrite(const std::string& what, int error) {
  const std::string reason = error != 0 ? std::strerror(error) : "the disk did not take all of it";
  throw OutputError("cannot write " + what + ": " + reason + "; " + Remedy(error) +
                    " run the same command again");
}

PartialFile::PartialFile(const fs::path& path) : path_(path), temporary_(TemporaryPath(path)) {
  std::error_code error;
  if (path_.has_parent_path()) fs::create_directories(path_.parent_path(), error);
  errno = error ? error.value() : 0;
  if (!error) stream_ = std::fopen(temporary_.c_str(), "wb");
  if (stream_ == nullptr) Fail();
}

PartialFile::~PartialFile() {
  if (stream_ != nullptr) std::fclose(stream_);
  std::error_code ignored;
  if (!temporary_.empty()) fs::remove(temporary_, ignored);
}

void PartialFile::Commit() {
  errno = 0;
  // A full disk may show only here, when the last buffer leaves.
  const bool written = std::ferror(stream_) == 0 && std::fflush(stream_) == 0;
  const bool closed = std::fclose(stream_) == 0;
  stream_ = nullptr;
  if (!written || !closed) Fail();
  std::error_code error;
  fs::rename(temporary_, path_, error);
  if (error) {
    errno = error.value();
    Fail();
  }
  temporary_.clear();
}

void PartialFile::Fail() const { FailToWrite(path_.string(), errno); }

}  // namespace sirpy
