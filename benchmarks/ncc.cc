// What one matching cost takes (a pixel, a plane, a source) on one thread:
//
//   ncc
//
// prints {"avx2": {"coherent": nanoseconds per cost, "random": ..., "patch": ...}, ...} for each
// instruction set of this processor: for planes like their neighbours', for planes anywhere in the
// depth range, and for the reference side, once per pixel. Least of many runs, so that other
// programs hardly count.
#include <algorithm>
#include <cstdio>
#include <ctime>
#include <limits>
#include <random>
#include <vector>

#include "patch_match/level.h"
#include "patch_match/pyramid.h"

namespace sirpy::patch_match {

#define SIRPY_DECLARE(isa)                                                                        \
  namespace isa {                                                                                 \
  float SumOfCosts(const Level& level, const KernelOptions& options, const Planes& planes, int y, \
                   int repeats);                                                                  \
  }
SIRPY_DECLARE(baseline)
#ifdef SIRPY_X86
SIRPY_DECLARE(avx2)
SIRPY_DECLARE(avx512)
#endif

namespace {

constexpr int kWidth = 640, kHeight = 480, kMargin = 200, kSources = 8;
constexpr float kRho = 0.01f;

double ThreadSeconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

// A camera that looks straight down, and sources around it that are turned a little. The images are
// noise: what they show does not change the time.
struct Scene {
  Level level;
  Block block{(1u << kSources) - 1, 0.5f * kRho, 1.5f * kRho};
  std::vector<uint8_t> grey;
  std::vector<uint32_t> quads;

  Scene() : grey((kWidth + 2 * kMargin) * (kHeight + 2 * kMargin)), quads(grey.size()) {
    std::mt19937 random(1);
    for (uint8_t& pixel : grey) pixel = uint8_t(random());
    const int width = kWidth + 2 * kMargin, height = kHeight + 2 * kMargin;
    PackQuads(grey.data(), width, height, quads.data());
    level.grey = grey.data();
    level.width = kWidth;
    level.height = kHeight;
    level.blocks = &block;
    level.block_side = kWidth + kHeight;
    level.block_columns = 1;
    level.num_sources = kSources;
    for (int j = 0; j < kSources; ++j) {
      SourceLevel& source = level.sources[j];
      source.quads = quads.data();
      source.width = width;
      source.height = height;
      const double turn = 0.01 * (j - kSources / 2), shift = 60.0 * (j - kSources / 2);
      const double a[9] = {1, -turn, kMargin - shift, turn, 1, kMargin, 0, 0, 1};
      const double b[3] = {shift / kRho, -shift / kRho / 3, 0.1 / kRho};
      std::copy(a, a + 9, source.a);
      std::copy(b, b + 3, source.b);
    }
  }
};

using Sum = decltype(&baseline::SumOfCosts);

double LeastSeconds(Sum sum, const Level& level, const Planes& planes, int repeats) {
  double least = std::numeric_limits<double>::infinity();
  volatile float kept = 0;  // so that nothing is left out
  for (int run = 0; run < 300; ++run) {
    const double begin = ThreadSeconds();
    kept = kept + sum(level, KernelOptions(), planes, kHeight / 2, repeats);
    least = std::min(least, ThreadSeconds() - begin);
  }
  return least;
}

void Print(const char* name, Sum sum, const Scene& scene, const Planes& coherent,
           const Planes& random, const char* separator) {
  constexpr int kRepeats = 8, kPixels = kWidth / 2;
  const double once = LeastSeconds(sum, scene.level, coherent, 1);
  const double again = LeastSeconds(sum, scene.level, coherent, 1 + kRepeats) - once;
  const double patch = once - again / kRepeats;
  const double scattered = LeastSeconds(sum, scene.level, random, 1) - patch;
  std::printf("\"%s\": {\"coherent\": %.1f, \"random\": %.1f, \"patch\": %.1f}%s", name,
              1e9 * again / (double(kPixels) * kRepeats * kSources),
              1e9 * scattered / (double(kPixels) * kSources), 1e9 * patch / kPixels, separator);
}

int Main() {
  const Scene scene;
  const size_t size = size_t(kWidth) * kHeight;
  std::vector<float> rho(size, kRho), anywhere(size), gx(size, 1e-4f * kRho), gy(size);
  std::mt19937 random(2);
  std::uniform_real_distribution<float> range(scene.block.min_inverse_depth,
                                              scene.block.max_inverse_depth);
  for (float& value : anywhere) value = range(random);
  const Planes coherent{rho.data(), gx.data(), gy.data(), nullptr, nullptr};
  const Planes scattered{anywhere.data(), gx.data(), gy.data(), nullptr, nullptr};
  std::printf("{");
#ifdef SIRPY_X86
  if (__builtin_cpu_supports("avx512bw")) {
    Print("avx512", avx512::SumOfCosts, scene, coherent, scattered, ", ");
  }
  if (__builtin_cpu_supports("avx2")) {
    Print("avx2", avx2::SumOfCosts, scene, coherent, scattered, ", ");
  }
#endif
  Print("baseline", baseline::SumOfCosts, scene, coherent, scattered, "}\n");
  return 0;
}

}  // namespace
}  // namespace sirpy::patch_match

int main() { return sirpy::patch_match::Main(); }
