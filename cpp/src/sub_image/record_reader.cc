#include "sub_image/record_reader.h"

#include <algorithm>
#include <cerrno>
#include <cmath>

#include "error.h"

namespace sirpy {
namespace {

constexpr int64_t kBuffer = 1 << 18;
constexpr size_t kLongestName = 4096;  // what a path may have on Linux

// Length of the UTF-8 character that begins at text[0], 0 when there is none.
size_t CharacterLength(const unsigned char* text, size_t left) {
  static constexpr uint32_t kLeast[] = {0, 0, 0x80, 0x800, 0x10000};
  const unsigned char first = text[0];
  if (first < 0x80) return 1;
  const size_t length = first >= 0xf8   ? 0
                        : first >= 0xf0 ? 4
                        : first >= 0xe0 ? 3
                        : first >= 0xc0 ? 2
                                        : 0;
  if (length == 0 || length > left) return 0;
  uint32_t code = first & (0x7f >> length);
  for (size_t i = 1; i < length; ++i) {
    if ((text[i] & 0xc0) != 0x80) return 0;
    code = code << 6 | (text[i] & 0x3f);
  }
  const bool surrogate = 0xd800 <= code && code < 0xe000;
  return code < kLeast[length] || surrogate || code > 0x10ffff ? 0 : length;
}

bool IsUtf8(const std::string& text) {
  const auto* bytes = reinterpret_cast<const unsigned char*>(text.data());
  for (size_t i = 0; i < text.size();) {
    const size_t length = CharacterLength(bytes + i, text.size() - i);
    if (length == 0) return false;
    i += length;
  }
  return true;
}

}  // namespace

RecordReader::RecordReader(const std::filesystem::path& path) : path_(path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);  // an error for what is no file
  if (!error) file_.reset(std::fopen(path.c_str(), "rb"));
  if (file_ == nullptr) {
    throw InputError(path.string() + " cannot be read (" +
                     (error ? error.message() : std::strerror(errno)) +
                     "): make it readable, or export the model again");
  }
  std::setvbuf(file_.get(), nullptr, _IONBF, 0);
  unread_ = static_cast<int64_t>(size);
  buffer_.resize(std::clamp<int64_t>(unread_, 64, kBuffer));
}

double RecordReader::TakeFinite(const char* what, uint64_t id) {
  const double value = Take<double>();
  if (!std::isfinite(value)) Damaged(what + (" " + std::to_string(id)) + " is not finite");
  return value;
}

int64_t RecordReader::Count(int64_t least_size) {
  const auto count = Take<uint64_t>();
  CheckCount(count, least_size);
  return static_cast<int64_t>(count);
}

void RecordReader::CheckCount(uint64_t count, int64_t least_size) const {
  if (count > static_cast<uint64_t>(left() / least_size)) {
    Damaged("it names " + std::to_string(count) + " records, more than its size holds");
  }
}

std::string RecordReader::Name() {
  std::string name;
  while (true) {
    if (left() == 0) Damaged("a name has no end");
    const char c = Take<char>();
    if (c == '\0') break;
    if (name.size() == kLongestName) Damaged("a name is longer than any path");
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      Damaged("a name has control characters");
    }
    name.push_back(c);
  }
  if (!IsUtf8(name)) Damaged("a name is not UTF-8 text");
  return name;
}

void RecordReader::Skip(int64_t size) {
  while (size > 0) {
    const int64_t step = std::min<int64_t>(size, static_cast<int64_t>(buffer_.size()));
    Bytes(static_cast<size_t>(step));
    size -= step;
  }
}

void RecordReader::End() const {
  if (left() > 0) Damaged(std::to_string(left()) + " bytes too many follow");
}

void RecordReader::Damaged(const std::string& what) const {
  throw InputError(path_.string() + " is damaged (" + what + "): export the model again");
}

void RecordReader::Fill(size_t size) {
  if (static_cast<int64_t>(size) > left()) Damaged("it ends too early");
  std::memmove(buffer_.data(), buffer_.data() + next_, filled_ - next_);
  filled_ -= next_;
  next_ = 0;
  const size_t wanted = std::min<size_t>(buffer_.size() - filled_, static_cast<size_t>(unread_));
  const size_t got = std::fread(buffer_.data() + filled_, 1, wanted, file_.get());
  filled_ += got;
  unread_ = got == wanted ? unread_ - static_cast<int64_t>(got) : 0;
  if (filled_ < size) Damaged("it ends too early");  // it has become shorter while it was read
}

}  // namespace sirpy
