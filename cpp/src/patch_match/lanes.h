// Lanes: SIRPY_LANES neighbouring pixels of one colour are worked on at once, one per SIMD lane.
// Written in the compiler's vector extensions, so one source serves every instruction set; no
// operation mixes lanes and none is contracted, so the results are the same bytes on each of them.
//
// Included only by kernels.cc, which is compiled once for each instruction set: everything is
// inside a namespace of that set, so that the linker can never share code between them.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX512F__) && SIRPY_LANES == 16
#include <immintrin.h>
#endif

namespace sirpy::patch_match::SIRPY_ISA {

constexpr int kLanes = SIRPY_LANES;

typedef float Floats __attribute__((vector_size(4 * SIRPY_LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * SIRPY_LANES)));
typedef uint32_t Words __attribute__((vector_size(4 * SIRPY_LANES)));

#define SIRPY_INLINE static inline __attribute__((always_inline))
#define SIRPY_FUNCTION static __attribute__((noinline))  // large, called from many places

SIRPY_INLINE Floats Splat(float value) { return Floats{} + value; }
SIRPY_INLINE Ints SplatInt(int32_t value) { return Ints{} + value; }

// Masks are Ints with all bits set (true) or none.
SIRPY_INLINE Floats Select(Ints mask, Floats yes, Floats no) {
  return (Floats)((mask & (Ints)yes) | (~mask & (Ints)no));
}
SIRPY_INLINE Floats Min(Floats a, Floats b) { return Select(a < b, a, b); }
SIRPY_INLINE Floats Max(Floats a, Floats b) { return Select(a > b, a, b); }
SIRPY_INLINE Floats Abs(Floats a) { return (Floats)((Ints)a & 0x7fffffff); }
SIRPY_INLINE bool Any(Ints mask) {
  int32_t any = 0;
  for (int lane = 0; lane < kLanes; ++lane) any |= mask[lane];
  return any != 0;
}

SIRPY_INLINE Ints Truncate(Floats a) { return __builtin_convertvector(a, Ints); }
SIRPY_INLINE Floats ToFloats(Ints a) { return __builtin_convertvector(a, Floats); }
SIRPY_INLINE Floats Sqrt(Floats a) {
  Floats root;
  for (int lane = 0; lane < kLanes; ++lane) root[lane] = __builtin_sqrtf(a[lane]);
  return root;
}

// table[index] in each lane.
SIRPY_INLINE Ints Gather(const uint32_t* table, Ints index) {
#if defined(__AVX512F__) && SIRPY_LANES == 16
  return (Ints)_mm512_i32gather_epi32((__m512i)index, table, 4);
#else
  // Plain loads: as fast as a hardware gather on many processors, and they need none.
  Ints values;
  for (int lane = 0; lane < kLanes; ++lane) values[lane] = (int32_t)table[index[lane]];
  return values;
#endif
}

// exp(a) for -80 < a < 80, relative error below 2e-5: 2^(a log2 e), the fraction by a polynomial.
SIRPY_INLINE Floats Exp(Floats a) {
  const Floats scaled = Min(Max(a, Splat(-80.f)), Splat(80.f)) * 1.44269504f;
  const Ints below = Truncate(scaled) + (scaled < 0.f);  // a true comparison is -1: floor
  const Floats f = scaled - ToFloats(below);
  const Floats power =
      1.f +
      f * (0.6931472f + f * (0.2402265f + f * (0.0555041f + f * (0.0096139f + f * 0.0013398f))));
  return (Floats)((Ints)power + (below << 23));
}

}  // namespace sirpy::patch_match::SIRPY_ISA
