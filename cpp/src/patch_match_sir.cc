#include "patch_match_sir.h"

#include <omp.h>

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "option_bounds.h"
#include "patch_match/initialise.h"
#include "patch_match/level.h"
#include "patch_match/pyramid.h"

namespace sirpy {

using patch_match::Assessment;
using patch_match::BestKernels;
using patch_match::Block;
using patch_match::BothPlanes;
using patch_match::KernelOptions;
using patch_match::Kernels;
using patch_match::kMaxSources;
using patch_match::kPatchRadius;
using patch_match::kSweepReach;
using patch_match::Level;
using patch_match::PlaneArrays;
using patch_match::Planes;
using patch_match::PlaneSource;
using patch_match::RandomPlanes;
using patch_match::StartPlanes;

namespace {

void Require(bool satisfied, const std::string& field, double value,
             const std::string& constraint) {
  RequireOption(satisfied, "PatchMatchOptions", field, value, field + " " + constraint);
}

KernelOptions MakeKernelOptions(const PatchMatchOptions& options, const float* noise) {
  KernelOptions kernel;
  kernel.noise = noise;
  kernel.color_sigma = float(options.color_sigma);
  kernel.space_sigma = float(options.space_sigma);
  kernel.geometric_weight = float(options.geometric_weight);
  kernel.max_geometric_error = float(options.max_geometric_error);
  kernel.consistency = float(options.consistency);
  kernel.agreement = float(options.agreement);
  kernel.prior_weight = float(options.prior_weight);
  kernel.top_views = options.top_views;
  kernel.refine = options.iterations > 0;
  return kernel;
}

// K at a level, with the centre of the first pixel at (0, 0) instead of (0.5, 0.5).
Eigen::Matrix3d LevelIntrinsics(const Eigen::Matrix3d& intrinsics, int level) {
  const double scale = 1.0 / (1 << level);
  Eigen::Matrix3d at_level = intrinsics;
  at_level.topRows<2>() *= scale;
  at_level(0, 2) -= 0.5;
  at_level(1, 2) -= 0.5;
  return at_level;
}

// a = K_to R K_from^-1 and b = K_to t of the transform to_from_from.
void SetWarp(const ViewWindow& from, const ViewWindow& to, double* a, double* b) {
  const Eigen::Matrix3d rotation = to.rotation * from.rotation.transpose();
  const Eigen::Vector3d translation = to.translation - rotation * from.translation;
  const Eigen::Matrix3d to_intrinsics = LevelIntrinsics(to.intrinsics, to.level);
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(a, 3, 3) =
      to_intrinsics * rotation * LevelIntrinsics(from.intrinsics, from.level).inverse();
  Eigen::Map<Eigen::Vector3d>(b, 3) = to_intrinsics * translation;
}

// Pixels: the kernels address the pixels around a position with a stride of 16 bits (ncc.h).
constexpr int64_t kMostSourceWidth = 1 << 15;

// Of a source without pixels: what the kernels read for a patch outside.
constexpr float kNoDepth[2] = {};

// The problem packed for the kernels: a Level and what it points to.
struct LevelData {
  Level level;
  std::vector<uint8_t> reference;
  std::vector<Block> blocks;
  std::vector<std::vector<uint32_t>> quads;
};

std::vector<Block> MakeBlocks(const ViewBlocks& blocks) {
  std::vector<Block> packed(size_t(blocks.columns) * blocks.rows);
  for (size_t i = 0; i < packed.size(); ++i) {
    if (!blocks.allowed[i]) continue;  // nothing to match: no plane is possible
    packed[i] = {blocks.allowed[i], 1 / blocks.max_depth[i], 1 / blocks.min_depth[i]};
  }
  return packed;
}

LevelData MakeLevel(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                    const ViewBlocks& blocks, const PatchMatchOptions& options) {
  LevelData data;
  Level& level = data.level;
  level.width = int(reference.rectangle.width);
  level.height = int(reference.rectangle.height);
  data.reference = patch_match::Padded(reference.grey, level.width, level.height, kPatchRadius);
  level.grey = data.reference.data();
  level.x0 = int(reference.rectangle.x0);
  level.y0 = int(reference.rectangle.y0);
  const Eigen::Matrix3d intrinsics = LevelIntrinsics(reference.intrinsics, reference.level);
  level.fx = float(intrinsics(0, 0));
  level.fy = float(intrinsics(1, 1));
  level.cx = float(intrinsics(0, 2));
  level.cy = float(intrinsics(1, 2));
  data.blocks = MakeBlocks(blocks);
  level.blocks = data.blocks.data();
  level.block_side = blocks.side >> reference.level;
  level.block_columns = blocks.columns;
  level.seed = options.seed;
  level.offers = options.offers;
  level.largest_step = float(options.largest_step);
  level.num_sources = int(sources.size());
  data.quads.resize(sources.size());
  const bool geometric = std::any_of(sources.begin(), sources.end(), [](const ViewWindow& view) {
    return view.inverse_depth != nullptr;
  });
  // Allocated here: running out of memory inside a parallel region would end the process.
  for (size_t j = 0; j < sources.size(); ++j) {
    if (sources[j].grey) data.quads[j].resize(size_t(sources[j].rectangle.Area()));
  }
#pragma omp parallel for schedule(dynamic)
  for (size_t j = 0; j < sources.size(); ++j) {
    const ViewWindow& view = sources[j];
    patch_match::SourceLevel& source = level.sources[j];
    if (!view.grey) {
      // Like a window that holds no patch: whether it is given must change nothing.
      if (geometric) source.inverse_depth = kNoDepth;
      continue;
    }
    source.width = int(view.rectangle.width);
    source.height = int(view.rectangle.height);
    patch_match::PackQuads(view.grey, source.width, source.height, data.quads[j].data());
    source.quads = data.quads[j].data();
    source.x0 = float(view.rectangle.x0);
    source.y0 = float(view.rectangle.y0);
    SetWarp(reference, view, source.a, source.b);
    SetWarp(view, reference, source.back_a, source.back_b);
    source.inverse_depth = view.inverse_depth;
    source.deviation = view.deviation;
  }
  return data;
}

// The best of what `source` proposes for each pixel.
PlaneArrays Initialise(const Level& level, const KernelOptions& options,
                       const PlaneSource& source) {
  PlaneArrays arrays(level);
  Planes planes = arrays.View();
  const Kernels& kernels = BestKernels();
  // Rows of candidates for each thread, allocated here as above.
  const size_t count = size_t(source.num_candidates()), width = size_t(level.width);
  std::vector<Planes> candidates(count * size_t(omp_get_max_threads()));
  std::vector<float> values(3 * width * candidates.size());
  std::vector<uint32_t> views(width * candidates.size());
  for (size_t i = 0; i < candidates.size(); ++i) {
    float* row = values.data() + 3 * width * i;
    candidates[i] = {row, row + width, row + 2 * width, nullptr, views.data() + width * i};
  }
#pragma omp parallel for schedule(dynamic)
  for (int y = 0; y < level.height; ++y) {
    const Planes* own = candidates.data() + count * size_t(omp_get_thread_num());
    for (size_t i = 0; i < count; ++i) source.FillRow(y, int(i), own[i]);
    kernels.evaluate_row(level, options, own, int(count), &planes, y);
  }
  return arrays;
}

void Sweep(const Level& level, const KernelOptions& options, int iterations, PlaneArrays* arrays) {
  Planes planes = arrays->View();
  const Kernels& kernels = BestKernels();
  for (int iteration = 0; iteration < iterations; ++iteration) {
    for (int colour = 0; colour < 2; ++colour) {
#pragma omp parallel for schedule(dynamic)
      for (int y = 0; y < level.height; ++y) {
        kernels.sweep_row(level, options, &planes, y, colour, iteration);
      }
    }
  }
}

// What the start knows of each pixel.
struct PriorMaps {
  std::vector<float> rho, deviation;
  std::vector<uint8_t> level;
};

PriorMaps MakePrior(const Level& level, const StartPlanes& start) {
  const size_t width = size_t(level.width), threads = size_t(omp_get_max_threads());
  const size_t size = width * level.height;
  PriorMaps prior{std::vector<float>(size), std::vector<float>(size), std::vector<uint8_t>(size)};
  std::vector<float> slopes(2 * width * threads);
  std::vector<uint32_t> views(width * threads);
#pragma omp parallel for
  for (int y = 0; y < level.height; ++y) {
    const size_t thread = size_t(omp_get_thread_num()), row = width * y;
    float* own = slopes.data() + 2 * width * thread;
    start.FillRow(
        y, 0, {prior.rho.data() + row, own, own + width, nullptr, views.data() + width * thread});
    start.FillKnownRow(y, prior.deviation.data() + row, prior.level.data() + row);
  }
  return prior;
}

// Refines the planes, unless they are only judged; of the result all but what follows from them
// alone.
PatchMatchResult Assess(const Level& level, const KernelOptions& options, PlaneArrays* arrays) {
  Planes planes = arrays->View();
  const Kernels& kernels = BestKernels();
  const size_t size = arrays->rho.size();
  PatchMatchResult result;
  result.cost.resize(size);
  result.num_seeing.resize(size);
  result.num_consistent.resize(size);
  result.texture.resize(size);
  result.sigma.resize(size);
  result.motion.resize(size);
  result.level.resize(size);
  Assessment assessment{result.cost.data(),       result.texture.data(),
                        result.num_seeing.data(), result.num_consistent.data(),
                        result.sigma.data(),      result.motion.data(),
                        result.level.data()};
#pragma omp parallel for schedule(dynamic)
  for (int y = 0; y < level.height; ++y) {
    kernels.finish_row(level, options, &planes, &assessment, y);
  }
  return result;
}

// Depths take the place of inverse depths, also of their deviations; levels that of being held. Of
// `level` only the camera and the window are read. `prior_level`: of what is held.
void SetDepths(const Level& level, int own_level, const std::vector<uint8_t>& prior_level,
               PlaneArrays* arrays, PatchMatchResult* into) {
  const Planes planes = arrays->View();
  const size_t size = arrays->rho.size();
  PatchMatchResult& result = *into;
  result.normal.resize(3 * size);
#pragma omp parallel for
  for (int y = 0; y < level.height; ++y) {
    for (int x = 0; x < level.width; ++x) {
      const size_t at = size_t(y) * level.width + x;
      float& depth = planes.rho[at];
      // The worst cost means that no source could be compared: there is no depth.
      if (result.num_seeing[at] == 0 || planes.cost[at] > 2 * patch_match::kWorstCost) {
        depth = result.sigma[at] = result.motion[at] = 0;
        result.level[at] = uint8_t(own_level);
        continue;
      }
      result.level[at] = result.level[at] ? prior_level[at] : uint8_t(own_level);
      result.sigma[at] /= depth * depth;
      const float shift = result.motion[at];
      result.motion[at] = shift > 0 ? 1 / (shift * depth * depth) : 0;
      const float dx = float(level.x0 + x) - level.cx, dy = float(level.y0 + y) - level.cy;
      const Eigen::Vector3f inward(level.fx * planes.gx[at], level.fy * planes.gy[at],
                                   planes.rho[at] - planes.gx[at] * dx - planes.gy[at] * dy);
      const Eigen::Vector3f normal = -inward.normalized();
      depth = 1 / depth;
      for (int i = 0; i < 3; ++i) result.normal[at + i * size] = normal[i];
    }
  }
  result.depth = std::move(arrays->rho);
  result.views = std::move(arrays->views);
}

// Where the start has no depth, or one that the block does not allow, another plane was looked at:
// nothing is said of it.
void LeaveOutOthers(const StartMaps& start, const Rectangle& window, PatchMatchResult* result) {
  constexpr float kRounding = 1e-5f;
  const size_t size = result->depth.size();
  for (int64_t y = 0; y < window.height; ++y) {
    const float* row = start.depth + (window.y0 + y - start.rectangle.y0) * start.rectangle.width +
                       (window.x0 - start.rectangle.x0);
    for (int64_t x = 0; x < window.width; ++x) {
      const size_t at = size_t(y * window.width + x);
      if (std::abs(result->depth[at] - row[x]) <= kRounding * row[x]) continue;
      result->depth[at] = 0;
      for (int i = 0; i < 3; ++i) result->normal[at + i * size] = 0;
      result->sigma[at] = 0;
      result->num_consistent[at] = 0;
    }
  }
}

// The number of threads inside its scope; the caller's is restored.
class ThreadCount {
 public:
  explicit ThreadCount(int threads) : before_(omp_get_max_threads()) {
    omp_set_num_threads(threads > 0 ? threads : omp_get_num_procs());
  }
  ~ThreadCount() { omp_set_num_threads(before_); }
  ThreadCount(const ThreadCount&) = delete;
  ThreadCount& operator=(const ThreadCount&) = delete;

 private:
  int before_;
};

void Check(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
           const ViewBlocks& blocks, const StartMaps* start) {
  const auto require = [](bool satisfied, const std::string& what) {
    if (!satisfied) throw std::invalid_argument("PatchMatchSir: " + what);
  };
  require(!sources.empty() && sources.size() <= kMaxSources,
          "needs 1 to 32 sources, not " + std::to_string(sources.size()));
  const auto check = [&](const ViewWindow& view, int least) {
    const Rectangle& window = view.rectangle;
    require(view.level >= 0 && view.level <= 16, "a level must be in [0, 16]");
    require(window.width >= least && window.height >= least,
            "a window must be " + std::to_string(least) + " pixels wide and high, or more");
    require(window.width <= std::numeric_limits<int32_t>::max() / window.height,
            "a window must have fewer than 2^31 pixels");
    const Eigen::Matrix3d& k = view.intrinsics;
    require(k(0, 0) > 0 && k(1, 1) > 0 && k(2, 2) == 1 && k(0, 1) == 0 && k.allFinite() &&
                view.rotation.allFinite() && view.translation.allFinite(),
            "a camera must be a finite pinhole without skew");
  };
  check(reference, 1);
  for (const ViewWindow& source : sources) {
    if (!source.grey) continue;
    check(source, 2);
    require(source.rectangle.width < kMostSourceWidth,
            "a source window must be less than 32768 pixels wide");
  }
  const int64_t side = blocks.side >> reference.level;
  require(side >= 1 && side << reference.level == blocks.side,
          "the side of a block must be a multiple of the level's pixel");
  const Rectangle covered{0, 0, side * blocks.columns, side * blocks.rows};
  require(covered.Contains(reference.rectangle), "the blocks must cover the reference window");
  for (int i = 0; i < blocks.columns * blocks.rows; ++i) {
    require(uint64_t(blocks.allowed[i]) >> sources.size() == 0,
            "a block allows a source that there is not");
    require(!blocks.allowed[i] ||
                (blocks.min_depth[i] > 0 && blocks.min_depth[i] <= blocks.max_depth[i]),
            "the depths of a block must be positive, the least first");
  }
  if (start) {
    const int coarser = start->level - reference.level;
    require(coarser == 0 || coarser == 1,
            "the start must be at the level of the reference or one coarser");
    require(start->rectangle.Area() > 0, "the start has no pixels");
    // Its pixels may begin half a coarse pixel later: those at the border stand for the missing
    // ones.
    const Rectangle& window = reference.rectangle;
    const int64_t x0 = (window.x0 >> coarser) + coarser, y0 = (window.y0 >> coarser) + coarser;
    const int64_t x1 = ((window.x1() - 1) >> coarser) + 1 - coarser,
                  y1 = ((window.y1() - 1) >> coarser) + 1 - coarser;
    require(start->rectangle.Contains({x0, y0, x1 - x0, y1 - y0}),
            "the start must cover the reference window");
  }
}

}  // namespace

void PatchMatchOptions::Validate() const {
  Require(iterations >= 0, "iterations", iterations, ">= 0");
  Require(offers >= 1 && offers <= 8, "offers", offers, "in [1, 8]");
  Require(largest_step > 0.1, "largest_step", largest_step, "> 0.1");
  Require(top_views >= 1 && top_views <= kMaxSources, "top_views", top_views, "in [1, 32]");
  Require(color_sigma > 0, "color_sigma", color_sigma, "> 0");
  Require(space_sigma > 0, "space_sigma", space_sigma, "> 0");
  Require(geometric_weight >= 0, "geometric_weight", geometric_weight, ">= 0");
  Require(max_geometric_error > 0, "max_geometric_error", max_geometric_error, "> 0");
  // A true plane must never cost more than one that cannot be compared.
  Require(geometric_weight * max_geometric_error < 2, "geometric_weight", geometric_weight,
          "< 2 / max_geometric_error");
  Require(consistency > 0, "consistency", consistency, "> 0");
  Require(prior_weight >= 0, "prior_weight", prior_weight, ">= 0");
  Require(agreement >= 0, "agreement", agreement, ">= 0");
  for (const double variance : noise) Require(variance > 0, "noise", variance, "> 0");
  Require(threads >= 0, "threads", threads, ">= 0");
}

PatchMatchResult PatchMatchSir(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                               const ViewBlocks& blocks, const std::vector<SparsePoint>& points,
                               const StartMaps* start, const PatchMatchOptions& options) {
  options.Validate();
  Check(reference, sources, blocks, start);
  if (options.iterations == 0 && !(start && start->level == reference.level)) {
    throw std::invalid_argument(
        "PatchMatchSir: without a sweep there must be a start of the same level");
  }
  const ThreadCount threads(options.threads);
  const std::vector<float> noise(options.noise.begin(), options.noise.end());
  KernelOptions kernel = MakeKernelOptions(options, noise.data());
  // Planes that are only judged are as sure as they were.
  kernel.carry = options.iterations == 0 && start->sigma != nullptr;
  LevelData data = MakeLevel(reference, sources, blocks, options);
  PlaneArrays planes;
  PriorMaps prior;
  data.level.everywhere = options.everywhere || !start;
  const RandomPlanes random(data.level, points, 1.0 / (1 << reference.level));
  if (start) {
    const StartPlanes before(data.level, *start, start->level > reference.level);
    if (start->sigma) {
      prior = MakePrior(data.level, before);
      data.level.prior = prior.rho.data();
      data.level.prior_deviation = prior.deviation.data();
    }
    planes = data.level.everywhere ? Initialise(data.level, kernel, BothPlanes(before, random))
                                   : Initialise(data.level, kernel, before);
  } else {
    planes = Initialise(data.level, kernel, random);
  }
  Sweep(data.level, kernel, options.iterations, &planes);
  PatchMatchResult result = Assess(data.level, kernel, &planes);
  // The pixels are not needed any more, and the largest maps are still to come.
  const Level level = data.level;
  data = LevelData();
  prior.rho = prior.deviation = std::vector<float>();
  SetDepths(level, reference.level, prior.level, &planes, &result);
  if (options.iterations == 0) LeaveOutOthers(*start, reference.rectangle, &result);
  return result;
}

int PatchMatchMargin(int iterations) {
  // Two half sweeps each; a plane is judged by its patch.
  return 2 * kSweepReach * iterations + kPatchRadius;
}

PatchMatchMemory PatchMatchBytesPerPixel() {
  // Reference: planes 20, prior 9, padded grey 1, assessment 19; source: quads 4. At the end
  // planes, assessment, levels of the prior and normals.
  return {49, 4, 52};
}

}  // namespace sirpy
