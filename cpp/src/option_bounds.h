// The sentence about an option that is out of its bounds.
#pragma once

#include <stdexcept>
#include <string>

namespace sirpy {

// Throws std::invalid_argument that names the options, the field, its value and the constraint.
inline void RequireOption(bool satisfied, const std::string& options, const std::string& field,
                          double value, const std::string& constraint) {
  if (satisfied) return;
  throw std::invalid_argument(options + "::" + field + " = " + std::to_string(value) +
                              ". Violated constraint: " + constraint);
}

}  // namespace sirpy
