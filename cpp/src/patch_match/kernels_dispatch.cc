#include <cstdlib>
#include <cstring>

#include "error.h"
#include "patch_match/level.h"

namespace sirpy::patch_match {

namespace baseline {
extern const Kernels kKernels;
}
#ifdef SIRPY_X86
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}
#endif

const Kernels& BestKernels() {
  const char* asked = std::getenv("SIRPY_ISA");
  const auto wanted = [&](const char* name) { return !asked || std::strcmp(asked, name) == 0; };
#ifdef SIRPY_X86
  if (__builtin_cpu_supports("avx512f") && wanted("avx512")) return avx512::kKernels;
  if (__builtin_cpu_supports("avx2") && wanted("avx2")) return avx2::kKernels;
#endif
  if (wanted("baseline")) return baseline::kKernels;
  throw InputError("SIRPY_ISA=" + std::string(asked) +
                   " is not an instruction set of this processor: use baseline, avx2 or avx512");
}

}  // namespace sirpy::patch_match
