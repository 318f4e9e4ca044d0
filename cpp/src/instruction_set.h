// The instruction set that kernels run on, chosen at run time. Kernels are compiled once for each
// (cpp/src/CMakeLists.txt), in a namespace of its name, and give the same bytes on every one.
#pragma once

namespace sirpy {

enum class InstructionSet { kBaseline, kAvx2, kAvx512 };

// The widest of this processor, or the one that the environment variable SIRPY_ISA names
// (baseline, avx2, avx512). Throws InputError when the processor lacks that one.
InstructionSet BestInstructionSet();

}  // namespace sirpy
