// For tests that run on every instruction set that this processor has.
#pragma once

#include <cstdlib>

#include "error.h"
#include "instruction_set.h"

namespace sirpy {

inline bool HasInstructionSet(const char* name) {
  setenv("SIRPY_ISA", name, 1);
  bool there = true;
  try {
    BestInstructionSet();
  } catch (const InputError&) {
    there = false;
  }
  unsetenv("SIRPY_ISA");
  return there;
}

}  // namespace sirpy
