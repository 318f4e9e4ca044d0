// Random numbers and smooth noise that are functions of place alone: the same on every thread and
// in every run. Noise is value noise (hashed lattice values, smoothly interpolated), in -1 .. 1.
#pragma once

#include <cstdint>

namespace sirpy {

// The finaliser of splitmix64: every bit of the result depends on every bit of the key.
inline uint64_t Hash(uint64_t key) {
  key += 0x9e3779b97f4a7c15ull;
  key = (key ^ (key >> 30)) * 0xbf58476d1ce4e5b9ull;
  key = (key ^ (key >> 27)) * 0x94d049bb133111ebull;
  return key ^ (key >> 31);
}

inline uint64_t Hash(uint64_t seed, int64_t a, int64_t b = 0, int64_t c = 0) {
  return Hash(Hash(Hash(seed + static_cast<uint64_t>(a)) + static_cast<uint64_t>(b)) +
              static_cast<uint64_t>(c));
}

// Uniform in 0 <= u < 1.
inline double Uniform(uint64_t hash) { return static_cast<double>(hash >> 11) * 0x1p-53; }

// std::floor for coordinates of a scene; a library call on processors without SSE4.1, and noise is
// mostly floors.
inline int64_t Floor(double x) {
  const auto whole = static_cast<int64_t>(x);
  return whole - (x < static_cast<double>(whole) ? 1 : 0);
}

// Interpolated lattice values at a place in the plane (or in space), in lattice units.
inline double Noise(uint64_t seed, double x, double y) {
  const int64_t column = Floor(x), row = Floor(y);
  double fx = x - static_cast<double>(column), fy = y - static_cast<double>(row);
  fx = fx * fx * (3 - 2 * fx);
  fy = fy * fy * (3 - 2 * fy);
  const auto value = [&](int64_t a, int64_t b) {
    return 2 * Uniform(Hash(seed ^ (static_cast<uint64_t>(a) * 0x8da6b343u +
                                    static_cast<uint64_t>(b) * 0xd8163841cb1ab5ull))) -
           1;
  };
  const double top = value(column, row) * (1 - fx) + value(column + 1, row) * fx;
  const double bottom = value(column, row + 1) * (1 - fx) + value(column + 1, row + 1) * fx;
  return top * (1 - fy) + bottom * fy;
}

inline double Noise(uint64_t seed, double x, double y, double z) {
  const int64_t layer = Floor(z);
  double fz = z - static_cast<double>(layer);
  fz = fz * fz * (3 - 2 * fz);
  return Noise(Hash(seed, layer), x, y) * (1 - fz) + Noise(Hash(seed, layer + 1), x, y) * fz;
}

}  // namespace sirpy
