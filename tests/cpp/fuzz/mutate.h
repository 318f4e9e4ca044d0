// Fuzzing without a coverage-guided engine: valid files are damaged at random, the same way for
// the same seed on every machine, and fed to a reader. A reader may take a damaged file or throw
// InputError; a crash, a sanitizer's report, another exception, a second of CPU time or 64 MB of
// memory for a case is a failure.
//
// To be included by one source file of a program: it replaces operator new, to count memory.
#pragma once

#include <malloc.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <exception>
#include <limits>
#include <new>
#include <random>
#include <string>
#include <utility>

#include "error.h"

namespace sirpy::fuzz {

constexpr double kMostSeconds = 1.0;          // of CPU time
constexpr int64_t kMostBytes = 64 << 20;      // of memory
constexpr unsigned kSecondsUntilHung = 120u;  // of wall time

inline std::atomic<int64_t> live_bytes{0};
inline std::atomic<int64_t> peak_bytes{0};
inline volatile int64_t current_case = 0;

}  // namespace sirpy::fuzz

void* operator new(size_t size) {
  void* memory = std::malloc(std::max<size_t>(size, 1));
  if (memory == nullptr) throw std::bad_alloc();
  const auto usable = static_cast<int64_t>(malloc_usable_size(memory));
  const int64_t live = sirpy::fuzz::live_bytes += usable;
  if (live > sirpy::fuzz::peak_bytes) sirpy::fuzz::peak_bytes = live;
  return memory;
}
void operator delete(void* memory) noexcept {
  sirpy::fuzz::live_bytes -= static_cast<int64_t>(malloc_usable_size(memory));
  std::free(memory);
}
void operator delete(void* memory, size_t) noexcept { operator delete(memory); }

// Sanitizers end by SIGABRT, so that the case is named; they keep little freed memory.
extern "C" const char* __asan_default_options() {
  return "abort_on_error=1:handle_abort=0:quarantine_size_mb=8";
}
extern "C" const char* __ubsan_default_options() {
  return "halt_on_error=1:abort_on_error=1:print_stacktrace=1";
}

namespace sirpy::fuzz {

using Random = std::mt19937_64;

inline uint64_t Below(Random& random, uint64_t bound) { return random() % bound; }

// `bytes` with one to four random changes; `other` is a file of the same kind.
class Mutator {
 public:
  explicit Mutator(Random& random) : random_(random) {}

  std::string operator()(std::string bytes, const std::string& other) {
    for (uint64_t changes = 1 + Below(random_, 4); changes > 0; --changes) Change(bytes, other);
    return bytes;
  }

 private:
  void Change(std::string& bytes, const std::string& other) {
    const size_t at = Place(bytes);
    switch (Below(random_, 9)) {
      case 0:
        if (!bytes.empty()) bytes[at % bytes.size()] ^= static_cast<char>(1 << Below(random_, 8));
        break;
      case 1:
        if (!bytes.empty()) bytes[at % bytes.size()] = static_cast<char>(random_());
        break;
      case 2:  // counts, ids and sizes
        Overwrite(bytes, at, Number(), 4);
        break;
      case 3:
        Overwrite(bytes, at, Number(), 8);
        break;
      case 4:
        Overwrite(bytes, at, Real(), 8);
        break;
      case 5:
        bytes.resize(at);
        break;
      case 6:
        bytes.erase(at, Below(random_, 40));
        break;
      case 7: {
        std::string more(Below(random_, 40), '\0');
        for (char& c : more) c = static_cast<char>(random_());
        bytes.insert(at, more);
        break;
      }
      default: {  // the end, or a piece, of another file
        const size_t from = Place(other);
        const size_t size = Below(random_, 2) ? other.size() : Below(random_, 100);
        bytes = bytes.substr(0, at) + other.substr(from, size) +
                (Below(random_, 2) ? bytes.substr(at) : "");
      }
    }
  }

  // Most headers lie at the beginning, and most records are aligned to 4 bytes.
  size_t Place(const std::string& bytes) {
    const size_t at = Below(random_, bytes.size() + 1);
    switch (Below(random_, 4)) {
      case 0:
        return 0;
      case 1:
        return std::min<size_t>(bytes.size(), Below(random_, 16));
      case 2:
        return at / 4 * 4;
      default:
        return at;
    }
  }

  static void Overwrite(std::string& bytes, size_t at, uint64_t value, size_t size) {
    if (at >= bytes.size()) return;
    std::memcpy(&bytes[at], &value, std::min(size, bytes.size() - at));
  }

  uint64_t Number() {
    const uint64_t power = uint64_t{1} << Below(random_, 64);
    switch (Below(random_, 4)) {
      case 0:
        return Below(random_, 20);
      case 1:
        return power - Below(random_, 3);
      case 2:
        return ~power;
      default:
        return random_();
    }
  }

  uint64_t Real() {
    using Limits = std::numeric_limits<double>;
    const double values[] = {Limits::quiet_NaN(),
                             Limits::infinity(),
                             -Limits::infinity(),
                             Limits::max(),
                             Limits::denorm_min(),
                             -0.0,
                             -1.0,
                             1e300,
                             1e18};
    uint64_t bits;
    std::memcpy(&bits, &values[Below(random_, std::size(values))], sizeof(bits));
    return bits;
  }

  Random& random_;
};

struct Options {
  uint64_t seed = 1;
  int64_t first = 0;
  int64_t cases = 1000;
};

// --seed S --first N --cases N; ends the program when it finds anything else.
inline Options ParseOptions(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; i += 2) {
    const std::string name = argv[i];
    const int64_t value = i + 1 < argc ? std::atoll(argv[i + 1]) : -1;
    if (value >= 0 && name == "--seed") {
      options.seed = static_cast<uint64_t>(value);
    } else if (value >= 0 && name == "--first") {
      options.first = value;
    } else if (value >= 0 && name == "--cases") {
      options.cases = value;
    } else {
      std::fprintf(stderr, "usage: %s [--seed S] [--first CASE] [--cases COUNT]\n", argv[0]);
      std::exit(2);
    }
  }
  return options;
}

namespace internal {

inline void NameTheCase(int signal) {
  std::fprintf(stderr, "signal %d in case %lld\n", signal, static_cast<long long>(current_case));
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

inline double CpuSeconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

inline int64_t PeakResidentBytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return int64_t{1024} * usage.ru_maxrss;
}

// What is wrong with what `read` does; empty when nothing is. Counts the files that it takes.
template <typename Read>
std::string Problem(Read& read, Random& random, int64_t& taken) {
  const double begin = CpuSeconds();
  const int64_t live = live_bytes, resident = PeakResidentBytes();
  peak_bytes = live;
  try {
    read(random);
    ++taken;
  } catch (const InputError& error) {
    if (std::strlen(error.what()) == 0 || std::strchr(error.what(), '\n') != nullptr) {
      return std::string("not one sentence: ") + error.what();
    }
  } catch (const std::exception& error) {
    return std::string("threw ") + error.what();
  }
  if (CpuSeconds() - begin > kMostSeconds) return "took more than a second";
  // The first counts what was asked for, the second what any library has touched.
  if (peak_bytes - live > kMostBytes || PeakResidentBytes() - resident > kMostBytes) {
    return "took more than 64 MB";
  }
  return "";
}

}  // namespace internal

// Calls read(random) for each case, with random numbers of its own; the exit status.
template <typename Read>
int Run(const Options& options, Read read) {
  std::signal(SIGABRT, &internal::NameTheCase);
  std::signal(SIGALRM, &internal::NameTheCase);
  int64_t taken = 0;
  for (int64_t i = options.first; i < options.first + options.cases; ++i) {
    current_case = i;
    alarm(kSecondsUntilHung);
    std::seed_seq seeds{options.seed, static_cast<uint64_t>(i)};
    Random random(seeds);
    const std::string problem = internal::Problem(read, random, taken);
    if (!problem.empty()) {
      std::fprintf(stderr, "seed %llu, case %lld: %s\n",
                   static_cast<unsigned long long>(options.seed), static_cast<long long>(i),
                   problem.c_str());
      return 1;
    }
  }
  std::printf("%lld cases, %lld of them taken\n", static_cast<long long>(options.cases),
              static_cast<long long>(taken));
  return 0;
}

}  // namespace sirpy::fuzz
