// Random numbers that depend on what they are for, never on order: hash(seed, native pixel,
// iteration and draw); the level and the pass are in the seed.
#pragma once

#include <cstdint>

namespace sirpy::patch_match {

// A 64-bit mixer (Stafford's variant 13 of the finaliser of MurmurHash3).
static inline uint64_t Mix(uint64_t z) {
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

static inline uint64_t Hash(uint64_t seed, uint64_t a, uint64_t b) {
  return Mix(Mix(seed ^ (a * 0x9e3779b97f4a7c15ull)) ^ (b * 0xd6e8feb86659fd93ull));
}

// Uniform in [0, 1), 24 bits.
static inline float Uniform(uint64_t hash) { return float(hash >> 40) * (1.f / 16777216.f); }

}  // namespace sirpy::patch_match
