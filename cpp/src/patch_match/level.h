// What the kernels work on: one reference window and its source windows at one level of the
// pyramid.
//
// Pixel coordinates here put the centre of a pixel at whole numbers (COLMAP's minus one half) and
// count from the origin of the whole native image at that level, so nothing depends on how the
// image was cut. A plane is stored as inverse depth rho (1 / z in the reference camera) at the
// pixel and its gradient (gx, gy) per pixel: rho(x + d) = rho + g d. A source sees the reference
// pixel x with inverse depth rho at
//   (a x~ + b rho), a = K_s R K_r^-1, b = K_s t, with (R, t) = source_from_reference.
#pragma once

#include <cstdint>

namespace sirpy::patch_match {

constexpr int kMaxSources = 32;
constexpr int kPatchRadius = 4;  // 9x9 pixels, every second one is sampled: 25 samples
constexpr int kPatchStep = 2;
constexpr int kBrightnesses = 16;  // steps of grey levels that noise is known of
constexpr float kWorstCost = 2;    // 1 - NCC is in [0, 2]; what cannot be compared costs this

struct SourceLevel {
  const uint32_t* quads = nullptr;       // height x width, of PackQuads
  const float* inverse_depth = nullptr;  // height x width or null; 0 where there is none
  const float* deviation = nullptr;      // its standard deviation; null: none
  int width = 0;
  int height = 0;
  float x0 = 0;  // origin of the window
  float y0 = 0;
  double a[9] = {};  // row-major
  double b[3] = {};
  double back_a[9] = {};  // the same from the source to the reference
  double back_b[3] = {};
};

// What is known of the pixels of a block before they are looked at.
struct Block {
  uint32_t allowed = 0;  // bit j: source j may be matched
  float min_inverse_depth = 0;
  float max_inverse_depth = 0;
};

struct Level {
  const uint8_t* grey = nullptr;  // the window with kPatchRadius more pixels on each side
  int width = 0;                  // of the window
  int height = 0;
  int x0 = 0;  // native position, at this level, of the window's first pixel
  int y0 = 0;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  const Block* blocks = nullptr;  // row-major, from the corner of the native image
  int block_side = 1;             // pixels of the level
  int block_columns = 0;
  int num_sources = 0;
  SourceLevel sources[kMaxSources];
  const float* prior = nullptr;  // inverse depth that weak texture keeps; null: nothing is known
  const float* prior_deviation = nullptr;  // its standard deviation; null with the prior
  uint64_t seed = 0;                       // of the run, the image and the pass
  int offers = 8;                          // planes of neighbours that are tried, of 8
  float largest_step = 2;                  // pixels of motion in the sources, of the first sweep
  bool everywhere = false;                 // depths at random too

  const Block& BlockAt(int x, int y) const {  // of a pixel of the window
    return blocks[int64_t((y0 + y) / block_side) * block_columns + (x0 + x) / block_side];
  }
};

// One value per pixel of the window, row-major; 20 bytes per pixel.
struct Planes {
  float* rho = nullptr;
  float* gx = nullptr;
  float* gy = nullptr;
  float* cost = nullptr;
  uint32_t* views = nullptr;  // bit j: source j is used
};

// What `finish_row` finds of the final planes.
struct Assessment {
  float* cost = nullptr;              // photometric cost over the selected sources
  float* texture = nullptr;           // bilaterally weighted variance of the patch, grey levels^2
  uint8_t* num_seeing = nullptr;      // sources that the pixel can be compared with
  uint8_t* num_consistent = nullptr;  // sources whose own depth agrees
  float* deviation = nullptr;         // standard deviation of the inverse depth
  float* shift = nullptr;             // pixels of motion per unit of inverse depth
  uint8_t* held = nullptr;            // 1: the prior knows more than this level's pixels
};

struct KernelOptions {
  float color_sigma = 20;         // grey levels, bilateral weight
  float space_sigma = 3;          // pixels, bilateral weight
  float geometric_weight = 0.2f;  // lambda
  float max_geometric_error = 3;  // pixels, T
  float consistency = 1;          // pixels: agreement of two depth maps, at least
  float agreement = 2.5f;         // standard deviations: agreement of two depths
  const float* noise = nullptr;   // kBrightnesses variances, grey levels squared
  float prior_weight = 1;         // of what the start knows of the depth
  int top_views = 4;              // sources that a pixel's cost is the mean of, at most
  bool refine = true;             // the depth, at the end
  bool carry = false;             // the prior's deviations are those of the planes
};

// One set per instruction set. Each works on one row: `colour` is (x + y) & 1 in native
// coordinates.
struct Kernels {
  const char* name;
  // `candidates`: `count` rows of planes; one without views is judged by those that
  // it looks best in.
  void (*evaluate_row)(const Level&, const KernelOptions&, const Planes* candidates, int count,
                       Planes* planes, int y);
  void (*sweep_row)(const Level&, const KernelOptions&, Planes* planes, int y, int colour,
                    int iteration);
  void (*finish_row)(const Level&, const KernelOptions&, Planes* planes, Assessment* assessment,
                     int y);
};

// The farthest that half a sweep looks for planes, pixels of the level.
constexpr int kSweepReach = 23;

// The widest set that this processor has; SIRPY_ISA=baseline|avx2|avx512 in the environment asks
// for another.
const Kernels& BestKernels();

}  // namespace sirpy::patch_match
