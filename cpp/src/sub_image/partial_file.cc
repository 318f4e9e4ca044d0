#include "sub_image/partial_file.h"

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "error.h"

namespace sirpy {

namespace fs = std::filesystem;

PartialFile::PartialFile(const fs::path& path)
    : path_(path),
      temporary_(path.parent_path() / ("." + path.stem().string() + "." + std::to_string(getpid()) +
                                       ".tmp" + path.extension().string())) {
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

void PartialFile::Fail() const {
  const std::string reason = errno != 0 ? std::strerror(errno) : "the disk did not take all of it";
  throw OutputError("cannot write " + path_.string() + ": " + reason +
                    "; free some space or choose another output folder, then run the same command "
                    "again");
}

}  // namespace sirpy
