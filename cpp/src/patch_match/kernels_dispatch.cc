#include "instruction_set.h"
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
  switch (BestInstructionSet()) {
#ifdef SIRPY_X86
    case InstructionSet::kAvx512:
      return avx512::kKernels;
    case InstructionSet::kAvx2:
      return avx2::kKernels;
#endif
    default:
      return baseline::kKernels;
  }
}

}  // namespace sirpy::patch_match
