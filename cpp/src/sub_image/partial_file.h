// A file that is written to a temporary name beside its own, and renamed when it is whole.
#pragma once

#include <cstdio>
#include <filesystem>
#include <string>

namespace sirpy {

// The name, beside `path`, of a file or folder that becomes `path` when it is whole:
// .STEM.PROCESS.tmp.EXTENSION, by which a later run knows what a killed one left behind. A long
// stem is shortened, so that every name a file system takes can be written.
std::filesystem::path TemporaryPath(const std::filesystem::path& path);

// Throws OutputError: that `what` cannot be written for the reason `error` (of errno, 0 when there
// is none), and how to mend that.
[[noreturn]] void FailToWrite(const std::string& what, int error);

class PartialFile {
 public:
  // Makes missing folders. Throws OutputError when the file cannot be opened.
  explicit PartialFile(const std::filesystem::path& path);
  // Removes what was written unless Commit() was called.
  ~PartialFile();
  PartialFile(const PartialFile&) = delete;
  PartialFile& operator=(const PartialFile&) = delete;

  std::FILE* stream() const { return stream_; }

  // Closes the file and gives it its name. Throws OutputError when the disk did not take all of it.
  void Commit();

  // Throws OutputError with the reason that `errno` holds.
  [[noreturn]] void Fail() const;

 private:
  std::filesystem::path path_;
  std::filesystem::path temporary_;
  std::FILE* stream_ = nullptr;
};

}  // namespace sirpy
