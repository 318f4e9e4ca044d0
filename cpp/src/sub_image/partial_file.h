// A file that is written to a temporary name beside its own, and renamed when it is whole.
#pragma once

#include <cstdio>
#include <filesystem>

namespace sirpy {

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
