// InputError: the user's data is at fault (a broken photograph, a bad size); OutputError: a file
// cannot be written (no permission, a full disk). The message says what, where and how to mend it.
// A mistake in the code throws std::invalid_argument or std::logic_error.
#pragma once

#include <stdexcept>
#include <string>

namespace sirpy {

class InputError : public std::runtime_error {
 public:
  explicit InputError(const std::string& what) : std::runtime_error(what) {}
};

class OutputError : public std::runtime_error {
 public:
  explicit OutputError(const std::string& what) : std::runtime_error(what) {}
};

}  // namespace sirpy
