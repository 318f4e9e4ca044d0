// Lanes: SIRPY_LANES neighbouring pixels of one colour are worked on at once, one per SIMD lane.
// Written in the compiler's vector extensions, so one source serves every instruction set; no
// operation mixes lanes and none is contracted, so the results are the same bytes on each of them.
//
// Included only by sources that are compiled once for each instruction set: everything is inside a
// namespace of that set, so that the linker can never share code between them.
#pragma once

#include <cstdint>
#include <cstring>

#if defined(__AVX512BW__) && SIRPY_LANES == 16
#include <immintrin.h>
#define SIRPY_SIMD(name) _mm512_##name
#define SIRPY_REGISTER __m512i
#elif defined(__AVX2__) && SIRPY_LANES == 8
#include <immintrin.h>
#define SIRPY_SIMD(name) _mm256_##name
#define SIRPY_REGISTER __m256i
#elif defined(__SSE2__)
#include <emmintrin.h>
#endif

static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "lanes are read in the order of bytes");

namespace sirpy::patch_match::SIRPY_ISA {

constexpr int kLanes = SIRPY_LANES;

typedef float Floats __attribute__((vector_size(4 * SIRPY_LANES)));
typedef int32_t Ints __attribute__((vector_size(4 * SIRPY_LANES)));
typedef uint32_t Words __attribute__((vector_size(4 * SIRPY_LANES)));
typedef int16_t Halves __attribute__((vector_size(4 * SIRPY_LANES)));  // two in each lane
typedef double Doubles __attribute__((vector_size(8 * SIRPY_LANES)));
typedef uint32_t Word __attribute__((may_alias));  // of a table of words or of floats
typedef uint64_t Pairs __attribute__((vector_size(4 * SIRPY_LANES)));  // of lanes

#define SIRPY_INLINE static inline __attribute__((always_inline))
#define SIRPY_FUNCTION static __attribute__((noinline))  // large, called from many places

SIRPY_INLINE Floats Splat(float value) { return Floats{} + value; }
SIRPY_INLINE Ints SplatInt(int32_t value) { return Ints{} + value; }

// Masks are Ints with all bits set (true) or none.
SIRPY_INLINE Floats Select(Ints mask, Floats yes, Floats no) {
  return (Floats)((mask & (Ints)yes) | (~mask & (Ints)no));
}
SIRPY_INLINE Ints Select(Ints mask, Ints yes, Ints no) { return (mask & yes) | (~mask & no); }
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

// Bytes 0, 2, 4 ... of 2 kLanes.
SIRPY_INLINE Floats EverySecondByte(const uint8_t* bytes) {
  typedef uint16_t Shorts __attribute__((vector_size(2 * SIRPY_LANES)));
  Shorts two;
  std::memcpy(&two, bytes, sizeof two);
  return __builtin_convertvector(two & 255, Floats);
}

// Numbers 0, 2, 4 ... of 2 kLanes.
SIRPY_INLINE Floats EverySecond(const float* numbers) {
  typedef uint64_t Twos __attribute__((vector_size(8 * SIRPY_LANES)));
  Twos two;
  std::memcpy(&two, numbers, sizeof two);
  return (Floats) __builtin_convertvector(two, Words);
}

// low * low + high * high of the halves of each lane.
SIRPY_INLINE Ints SumOfProducts(Halves a, Halves b) {
#ifdef SIRPY_SIMD
  return (Ints)SIRPY_SIMD(madd_epi16)((SIRPY_REGISTER)a, (SIRPY_REGISTER)b);
#elif defined(__SSE2__) && SIRPY_LANES == 4
  return (Ints)_mm_madd_epi16((__m128i)a, (__m128i)b);
#else
  return ((Ints)a << 16 >> 16) * ((Ints)b << 16 >> 16) + ((Ints)a >> 16) * ((Ints)b >> 16);
#endif
}

// The same of the two bytes of each half, those of `a` without and those of `b` with a sign; the
// sums must fit.
SIRPY_INLINE Halves SumsOfByteProducts(Words a, Words b) {
#ifdef SIRPY_SIMD
  return (Halves)SIRPY_SIMD(maddubs_epi16)((SIRPY_REGISTER)a, (SIRPY_REGISTER)b);
#else
  const Halves low = (Halves)(a & 0x00ff00ffu), high = (Halves)((a >> 8) & 0x00ff00ffu);
  return low * ((Halves)b << 8 >> 8) + high * ((Halves)b >> 8);
#endif
}

// Byte `source` of each lane, times the number `times` (which has bytes of 0 and 1 only).
template <int source, uint32_t times>
SIRPY_INLINE Words RepeatByte(Words a) {
#ifdef SIRPY_SIMD
  Words from;  // which byte of its 16 each one takes; 128 makes a 0
  for (uint32_t lane = 0; lane < kLanes; ++lane) {
    from[lane] = times * (lane % 4 * 4 + source) + (~(times * 255) & 0x80808080u);
  }
  return (Words)SIRPY_SIMD(shuffle_epi8)((SIRPY_REGISTER)a, (SIRPY_REGISTER)from);
#else
  Words byte = (a >> (8 * source)) & 255u;
  if (times >> 16 != 0) byte |= byte << 16;
  return (times & 0x100) != 0 ? byte | byte << 8 : byte;
#endif
}

// table[index] in each lane; no index is negative.
SIRPY_INLINE Ints Gather(const Word* table, Ints index) {
#if defined(SIRPY_SIMD) && SIRPY_LANES == 16
  return (Ints)_mm512_i32gather_epi32((__m512i)index, table, 4);
#else
  // Plain loads: faster than the gather of AVX2 on the processors that were tried.
  Ints values;
  for (int lane = 0; lane < kLanes; lane += 2) {
    const uint64_t pair = ((Pairs)index)[lane / 2];
    values[lane] = int32_t(table[uint32_t(pair)]);
    values[lane + 1] = int32_t(table[pair >> 32]);
  }
  return values;
#endif
}
SIRPY_INLINE Floats Gather(const float* table, Ints index) {
  return (Floats)Gather(reinterpret_cast<const Word*>(table), index);
}

// exp(a) for -80 < a < 80, relative error below 1e-5: 2^(a log2 e), the fraction by the polynomial
// of least relative error (2e-7; the rest is the rounding of a) that is 1 at 0 and 2 at 1.
SIRPY_INLINE Floats Exp(Floats a) {
  const Floats scaled = Min(Max(a, Splat(-80.f)), Splat(80.f)) * 1.44269504f;
  const Ints below = Truncate(scaled) + (scaled < 0.f);  // a true comparison is -1: floor
  const Floats f = scaled - ToFloats(below);
  const Floats power =
      1.f + f * (0.6931517f +
                 f * (0.24015927f + f * (0.055818677f + f * (0.008990996f + f * 0.0018793186f))));
  return (Floats)((Ints)power + (below << 23));
}

}  // namespace sirpy::patch_match::SIRPY_ISA
