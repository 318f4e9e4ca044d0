#include "patch_match_sir.h"

#include <omp.h>

#include <algorithm>
#include <limits>
#include <stdexcept>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "patch_match/initialise.h"
#include "patch_match/level.h"
#include "patch_match/pyramid.h"

namespace sirpy {

using patch_match::Assessment;
using patch_match::BestKernels;
using patch_match::CoarserPlanes;
using patch_match::GivenPlanes;
using patch_match::GreyImage;
using patch_match::KernelOptions;
using patch_match::Kernels;
using patch_match::kMaxSources;
using patch_match::kPatchRadius;
using patch_match::Level;
using patch_match::PlaneArrays;
using patch_match::Planes;
using patch_match::PlaneSource;
using patch_match::RandomPlanes;

namespace {

void Require(bool satisfied, const std::string& field, double value,
             const std::string& constraint) {
  if (satisfied) return;
  throw std::invalid_argument("PatchMatchOptions::" + field + " = " + std::to_string(value) +
                              ". Violated constraint: " + field + " " + constraint);
}

KernelOptions MakeKernelOptions(const PatchMatchOptions& options) {
  KernelOptions kernel;
  kernel.color_sigma = float(options.color_sigma);
  kernel.space_sigma = float(options.space_sigma);
  kernel.geometric_weight = float(options.geometric_weight);
  kernel.max_geometric_error = float(options.max_geometric_error);
  kernel.consistency = float(options.consistency);
  kernel.prior_variance = float(options.prior_variance);
  kernel.top_views = options.top_views;
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
void SetWarp(const ViewWindow& from, const ViewWindow& to, int level, double* a, double* b) {
  const Eigen::Matrix3d rotation = to.rotation * from.rotation.transpose();
  const Eigen::Vector3d translation = to.translation - rotation * from.translation;
  const Eigen::Matrix3d to_intrinsics = LevelIntrinsics(to.intrinsics, level);
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(a, 3, 3) =
      to_intrinsics * rotation * LevelIntrinsics(from.intrinsics, level).inverse();
  Eigen::Map<Eigen::Vector3d>(b, 3) = to_intrinsics * translation;
}

// One level of the problem: the reference and source windows, packed for the kernels.
struct LevelData {
  Level level;
  std::vector<uint8_t> reference;
  std::vector<std::vector<uint32_t>> quads;
  std::vector<std::vector<float>> inverse_depths;
};

// Levels 1 and up of each window; empty in the geometric pass, which needs none.
struct Pyramids {
  std::vector<GreyImage> reference;
  std::vector<std::vector<GreyImage>> sources;
};

struct LevelWindow {
  const uint8_t* grey;
  int width, height;
};

LevelWindow AtLevel(const ViewWindow& view, const std::vector<GreyImage>& pyramid, int level) {
  if (level == 0) return {view.grey, int(view.rectangle.width), int(view.rectangle.height)};
  const GreyImage& image = pyramid[level - 1];
  return {image.pixels.data(), image.width, image.height};
}

LevelData MakeLevel(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                    const Pyramids& pyramids, const PatchMatchOptions& options, int number) {
  LevelData data;
  Level& level = data.level;
  const LevelWindow window = AtLevel(reference, pyramids.reference, number);
  data.reference = patch_match::Padded(window.grey, window.width, window.height, kPatchRadius);
  level.grey = data.reference.data();
  level.width = window.width;
  level.height = window.height;
  level.x0 = int(reference.rectangle.x0 >> number);
  level.y0 = int(reference.rectangle.y0 >> number);
  const Eigen::Matrix3d intrinsics = LevelIntrinsics(reference.intrinsics, number);
  level.fx = float(intrinsics(0, 0));
  level.fy = float(intrinsics(1, 1));
  level.cx = float(intrinsics(0, 2));
  level.cy = float(intrinsics(1, 2));
  level.min_inverse_depth = float(1 / options.max_depth);
  level.max_inverse_depth = float(1 / options.min_depth);
  level.seed = options.seed;
  level.level = number;
  level.offers = number == 0 ? options.native_offers : 8;
  level.num_sources = int(sources.size());
  data.quads.resize(sources.size());
  data.inverse_depths.resize(sources.size());
  // Allocated here: running out of memory inside a parallel region would end the process.
  for (size_t j = 0; j < sources.size(); ++j) {
    const LevelWindow pixels = AtLevel(sources[j], pyramids.sources[j], number);
    data.quads[j].resize(size_t(pixels.width) * pixels.height);
    if (sources[j].depth) data.inverse_depths[j].resize(data.quads[j].size());
  }
#pragma omp parallel for schedule(dynamic)
  for (size_t j = 0; j < sources.size(); ++j) {
    const ViewWindow& view = sources[j];
    patch_match::SourceLevel& source = level.sources[j];
    const LevelWindow pixels = AtLevel(view, pyramids.sources[j], number);
    patch_match::PackQuads(pixels.grey, pixels.width, pixels.height, data.quads[j].data());
    source.quads = data.quads[j].data();
    source.width = pixels.width;
    source.height = pixels.height;
    source.x0 = float(view.rectangle.x0 >> number);
    source.y0 = float(view.rectangle.y0 >> number);
    SetWarp(reference, view, number, source.a, source.b);
    SetWarp(view, reference, number, source.back_a, source.back_b);
    if (!view.depth) continue;
    std::vector<float>& inverse = data.inverse_depths[j];
    for (size_t i = 0; i < inverse.size(); ++i) {
      inverse[i] = view.depth[i] > 0 ? 1 / view.depth[i] : 0;
    }
    source.inverse_depth = inverse.data();
  }
  return data;
}

// The best of what `source` proposes for each pixel.
PlaneArrays Initialise(const Level& level, const KernelOptions& options,
                       const PlaneSource& source) {
  PlaneArrays arrays(level);
  Planes planes = arrays.View();
  const Kernels& kernels = BestKernels();
#pragma omp parallel
  {
    std::vector<float> row(3 * size_t(level.width));
    const Planes candidates{row.data(), row.data() + level.width, row.data() + 2 * level.width,
                            nullptr, nullptr};
#pragma omp for schedule(dynamic)
    for (int y = 0; y < level.height; ++y) {
      for (int i = 0; i < source.num_candidates(); ++i) {
        source.FillRow(y, i, candidates);
        kernels.evaluate_row(level, options, candidates, &planes, y);
      }
    }
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

// Inverse depth that the first candidate of `source` gives each pixel.
std::vector<float> Prior(const Level& level, const PlaneSource& source) {
  std::vector<float> prior(size_t(level.width) * level.height);
#pragma omp parallel
  {
    std::vector<float> slopes(2 * size_t(level.width));
#pragma omp for
    for (int y = 0; y < level.height; ++y) {
      source.FillRow(y, 0,
                     {prior.data() + size_t(y) * level.width, slopes.data(),
                      slopes.data() + level.width, nullptr, nullptr});
    }
  }
  return prior;
}

PatchMatchResult Finish(const Level& level, const KernelOptions& options, PlaneArrays* arrays) {
  Planes planes = arrays->View();
  const Kernels& kernels = BestKernels();
  const size_t size = arrays->rho.size();
  PatchMatchResult result;
  result.cost.resize(size);
  result.num_seeing.resize(size);
  result.num_consistent.resize(size);
  Assessment assessment{result.cost.data(), result.num_seeing.data(), result.num_consistent.data()};
#pragma omp parallel for schedule(dynamic)
  for (int y = 0; y < level.height; ++y) kernels.refine_row(level, options, &planes, y);
#pragma omp parallel for schedule(dynamic)
  for (int y = 0; y < level.height; ++y) {
    kernels.assess_row(level, options, planes, &assessment, y);
  }
  result.depth.resize(size);
  result.normal.resize(3 * size);
#pragma omp parallel for
  for (int y = 0; y < level.height; ++y) {
    for (int x = 0; x < level.width; ++x) {
      const size_t at = size_t(y) * level.width + x;
      // The worst cost means that no source could be compared: there is no depth.
      if (result.num_seeing[at] == 0 || planes.cost[at] > 2 * patch_match::kWorstCost) continue;
      const float dx = float(level.x0 + x) - level.cx, dy = float(level.y0 + y) - level.cy;
      const Eigen::Vector3f inward(level.fx * planes.gx[at], level.fy * planes.gy[at],
                                   planes.rho[at] - planes.gx[at] * dx - planes.gy[at] * dy);
      const Eigen::Vector3f normal = -inward.normalized();
      result.depth[at] = 1 / planes.rho[at];
      for (int i = 0; i < 3; ++i) result.normal[at + i * size] = normal[i];
    }
  }
  return result;
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

int Iterations(const PatchMatchOptions& options, int level) {
  if (level == 0) return options.native_iterations;
  return level == options.levels - 1 ? options.coarsest_iterations : options.middle_iterations;
}

PatchMatchResult PhotometricPass(const ViewWindow& reference,
                                 const std::vector<ViewWindow>& sources,
                                 const std::vector<SparsePoint>& points,
                                 const PatchMatchOptions& options) {
  const KernelOptions kernel = MakeKernelOptions(options);
  Pyramids pyramids;
  const auto pyramid = [&](const ViewWindow& view) {
    return patch_match::Pyramid(view.grey, int(view.rectangle.width), int(view.rectangle.height),
                                options.levels);
  };
  pyramids.reference = pyramid(reference);
  for (const ViewWindow& source : sources) pyramids.sources.push_back(pyramid(source));

  PlaneArrays planes;
  for (int number = options.levels - 1;; --number) {
    LevelData data = MakeLevel(reference, sources, pyramids, options, number);
    Level& level = data.level;
    level.coarsest = number == options.levels - 1;
    std::vector<float> prior;
    if (level.coarsest) {
      planes = Initialise(level, kernel, RandomPlanes(level, points));
    } else {
      const CoarserPlanes coarser(level, planes);
      prior = Prior(level, coarser);
      level.prior = prior.data();
      planes = Initialise(level, kernel, coarser);
    }
    Sweep(level, kernel, Iterations(options, number), &planes);
    if (number == 0) return Finish(level, kernel, &planes);
  }
}

PatchMatchResult GeometricPass(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                               const PatchMatchOptions& options) {
  const KernelOptions kernel = MakeKernelOptions(options);
  Pyramids none;
  none.sources.resize(sources.size());
  LevelData data = MakeLevel(reference, sources, none, options, 0);
  const GivenPlanes given(data.level, reference.depth, reference.normal);
  const std::vector<float> prior = Prior(data.level, given);
  data.level.prior = prior.data();
  PlaneArrays planes = Initialise(data.level, kernel, given);
  Sweep(data.level, kernel, options.geometric_iterations, &planes);
  return Finish(data.level, kernel, &planes);
}

}  // namespace

void PatchMatchOptions::Validate() const {
  Require(min_depth > 0, "min_depth", min_depth, "> 0");
  Require(max_depth > min_depth, "max_depth", max_depth, "> min_depth");
  Require(levels >= 1 && levels <= 6, "levels", levels, "in [1, 6]");
  Require(coarsest_iterations >= 1, "coarsest_iterations", coarsest_iterations, ">= 1");
  Require(middle_iterations >= 1, "middle_iterations", middle_iterations, ">= 1");
  Require(native_iterations >= 1, "native_iterations", native_iterations, ">= 1");
  Require(geometric_iterations >= 1, "geometric_iterations", geometric_iterations, ">= 1");
  Require(native_offers >= 1 && native_offers <= 8, "native_offers", native_offers, "in [1, 8]");
  Require(top_views >= 1 && top_views <= kMaxSources, "top_views", top_views, "in [1, 16]");
  Require(color_sigma > 0, "color_sigma", color_sigma, "> 0");
  Require(space_sigma > 0, "space_sigma", space_sigma, "> 0");
  Require(geometric_weight >= 0, "geometric_weight", geometric_weight, ">= 0");
  Require(max_geometric_error > 0, "max_geometric_error", max_geometric_error, "> 0");
  // A true plane must never cost more than one that cannot be compared.
  Require(geometric_weight * max_geometric_error < 2, "geometric_weight", geometric_weight,
          "< 2 / max_geometric_error");
  Require(consistency > 0, "consistency", consistency, "> 0");
  Require(prior_variance > 0, "prior_variance", prior_variance, "> 0");
  Require(threads >= 0, "threads", threads, ">= 0");
}

PatchMatchResult PatchMatchSir(const ViewWindow& reference, const std::vector<ViewWindow>& sources,
                               const std::vector<SparsePoint>& points,
                               const PatchMatchOptions& options) {
  options.Validate();
  if (sources.empty() || sources.size() > kMaxSources) {
    throw std::invalid_argument("PatchMatchSir needs 1 to 16 sources, not " +
                                std::to_string(sources.size()));
  }
  const bool geometric = sources.front().depth != nullptr;
  const int64_t step = int64_t(1) << (options.levels - 1);
  const auto check = [&](const ViewWindow& view) {
    if (view.rectangle.width < 2 || view.rectangle.height < 2 || view.rectangle.x0 % step ||
        view.rectangle.y0 % step) {
      throw std::invalid_argument(
          "a window must be 2x2 pixels or more and start at a multiple of " + std::to_string(step) +
          " pixels");
    }
    if (view.rectangle.width > std::numeric_limits<int32_t>::max() / view.rectangle.height) {
      throw std::invalid_argument("a window must have fewer than 2^31 pixels");
    }
    const Eigen::Matrix3d& k = view.intrinsics;
    if (!(k(0, 0) > 0 && k(1, 1) > 0 && k(2, 2) == 1 && k(0, 1) == 0 && k.allFinite() &&
          view.rotation.allFinite() && view.translation.allFinite())) {
      throw std::invalid_argument("a camera must be a finite pinhole without skew");
    }
    if ((view.depth != nullptr) != geometric) {
      throw std::invalid_argument("either all windows have depths or none has");
    }
  };
  check(reference);
  for (const ViewWindow& source : sources) check(source);
  if (geometric && !reference.normal) {
    throw std::invalid_argument("the geometric pass needs the reference's normals");
  }
  const ThreadCount threads(options.threads);
  return geometric ? GeometricPass(reference, sources, options)
                   : PhotometricPass(reference, sources, points, options);
}

PatchMatchMemory PatchMatchBytesPerPixel(bool geometric) {
  // Reference: planes 18, prior 4, padded grey 1, results 22; photometric: a pyramid of 1/3.
  // Source: quads 4, and a pyramid of 1/3 or inverse depths of 4.
  return geometric ? PatchMatchMemory{45, 8} : PatchMatchMemory{46, 5};
}

}  // namespace sirpy
