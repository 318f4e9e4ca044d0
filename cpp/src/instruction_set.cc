#include "instruction_set.h"

#include <cstdlib>
#include <cstring>

#include "error.h"

namespace sirpy {

InstructionSet BestInstructionSet() {
  const char* asked = std::getenv("SIRPY_ISA");
  const auto wanted = [&](const char* name) { return !asked || std::strcmp(asked, name) == 0; };
#ifdef SIRPY_X86
  if (__builtin_cpu_supports("avx512bw") && wanted("avx512")) return InstructionSet::kAvx512;
  if (__builtin_cpu_supports("avx2") && wanted("avx2")) return InstructionSet::kAvx2;
#endif
  if (wanted("baseline")) return InstructionSet::kBaseline;
  throw InputError("SIRPY_ISA=" + std::string(asked) +
                   " is not an instruction set of this processor: use baseline, avx2 or avx512");
}

}  // namespace sirpy
