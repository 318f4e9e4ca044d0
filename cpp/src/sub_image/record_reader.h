// The records of one binary file of a COLMAP model (little-endian, without padding), read in
// order through a buffer and never past the end. Counts are held against the bytes that are left
// before anything is allocated for them, so memory is bounded by the size of the file. All
// mistakes of the file are InputErrors that name it.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

namespace sirpy {

class RecordReader {
 public:
  // Throws InputError when the file cannot be opened.
  explicit RecordReader(const std::filesystem::path& path);

  template <typename T>
  T Take() {
    static_assert(std::is_arithmetic_v<T>);
    T value;
    std::memcpy(&value, Bytes(sizeof(T)), sizeof(T));
    return value;
  }

  // A finite number of what `what` and `id` name.
  double TakeFinite(const char* what, uint64_t id);

  // A number of records of at least `least_size` bytes each, which the rest of the file can hold.
  int64_t Count(int64_t least_size);
  // Throws InputError unless `count` records of `least_size` bytes can follow.
  void CheckCount(uint64_t count, int64_t least_size) const;

  // Text that ends with a zero byte: UTF-8 without control characters.
  std::string Name();

  void Skip(int64_t size);

  // Throws InputError when bytes follow.
  void End() const;

  [[noreturn]] void Damaged(const std::string& what) const;

 private:
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };

  int64_t left() const { return unread_ + static_cast<int64_t>(filled_ - next_); }
  // The next `size` bytes, which are valid until the next call.
  const unsigned char* Bytes(size_t size) {
    if (filled_ - next_ < size) Fill(size);
    const unsigned char* bytes = buffer_.data() + next_;
    next_ += size;
    return bytes;
  }
  // Reads on, so that the buffer holds at least `size` bytes.
  void Fill(size_t size);

  std::filesystem::path path_;
  std::unique_ptr<std::FILE, Close> file_;
  int64_t unread_ = 0;  // bytes of the file that are not in the buffer yet
  std::vector<unsigned char> buffer_;
  size_t next_ = 0;
  size_t filled_ = 0;
};

}  // namespace sirpy
