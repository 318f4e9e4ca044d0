#include "fusion.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "fusion_kernels.h"
#include "instruction_set.h"
#include "is_depth.h"
#include "option_bounds.h"

namespace sirpy {
namespace fusion {

namespace baseline {
extern const Kernels kKernels;
}
#ifdef SIRPY_X86
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}
#endif

}  // namespace fusion

namespace {

using RowMajor = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

const fusion::Kernels& BestKernels() {
  switch (BestInstructionSet()) {
#ifdef SIRPY_X86
    case InstructionSet::kAvx512:
      return fusion::avx512::kKernels;
    case InstructionSet::kAvx2:
      return fusion::avx2::kKernels;
#endif
    default:
      return fusion::baseline::kKernels;
  }
}

void Require(bool satisfied, const std::string& field, double value,
             const std::string& constraint) {
  RequireOption(satisfied, "FusionOptions", field, value, field + " " + constraint);
}

// K of a camera whose pixel centres are at whole numbers.
Eigen::Matrix3d CentredIntrinsics(const DepthView& view) {
  Eigen::Matrix3d intrinsics = view.intrinsics;
  intrinsics(0, 2) -= 0.5;
  intrinsics(1, 2) -= 0.5;
  return intrinsics;
}

struct ReferenceCamera {
  explicit ReferenceCamera(const DepthView& view)
      : intrinsics(CentredIntrinsics(view)),
        inverse_intrinsics(intrinsics.inverse()),
        world_from_cam(view.rotation.transpose()),
        translation(view.translation) {
    Eigen::Map<RowMajor>(kernel.inverse_intrinsics) = inverse_intrinsics;
    kernel.focal_area = intrinsics(0, 0) * intrinsics(1, 1);
  }

  Eigen::Vector3d World(double x, double y, double z) const {
    return world_from_cam * (inverse_intrinsics * Eigen::Vector3d(x, y, 1) * z - translation);
  }

  Eigen::Matrix3d intrinsics, inverse_intrinsics, world_from_cam;
  Eigen::Vector3d translation;
  fusion::Reference kernel;
};

// A source as the reference sees it.
struct AskedSource {
  AskedSource(const ReferenceCamera& camera, const DepthView& reference, const DepthView& view,
              uint32_t bit)
      : bit(bit),
        rank(view.rank),
        inverse_depth(size_t(view.rectangle.Area())),
        deviation(view.sigma ? inverse_depth.size() : 0) {
    const Eigen::Matrix3d intrinsics = CentredIntrinsics(view);
    const Eigen::Matrix3d rotation = view.rotation * camera.world_from_cam;  // from reference
    const Eigen::Vector3d translation = view.translation - rotation * camera.translation;
    const Eigen::Vector3d centre = -rotation.transpose() * translation;
    Eigen::Map<RowMajor>(kernel.along) = intrinsics * rotation * camera.inverse_intrinsics;
    Eigen::Map<Eigen::Vector3d>(kernel.offset) = intrinsics * translation;
    Eigen::Map<Eigen::Vector3d>(kernel.centre) = centre;
    Eigen::Map<Eigen::Vector3d>(kernel.back) = camera.intrinsics * centre;
    kernel.focal_area = intrinsics(0, 0) * intrinsics(1, 1);
    kernel.comes_first = view.rank < reference.rank;
    kernel.x0 = view.rectangle.x0;
    kernel.y0 = view.rectangle.y0;
    kernel.width = view.rectangle.width;
    kernel.height = view.rectangle.height;
    BestKernels().invert(view.depth, int64_t(inverse_depth.size()), inverse_depth.data());
    kernel.inverse_depth = inverse_depth.data();
    kernel.deviation = view.sigma ? deviation.data() : nullptr;
    if (view.sigma) {
      BestKernels().deviations(view.sigma, inverse_depth.data(), int64_t(inverse_depth.size()),
                               deviation.data());
    }
  }

  uint32_t bit;  // of the blocks
  int rank;
  std::vector<float> inverse_depth, deviation;
  fusion::Source kernel;
};

// What a pixel gives: nothing, or a point at the mean depth.
struct Fused {
  std::vector<double> depth;  // 0 where there is no point
  std::vector<float> sigma;
  std::vector<uint8_t> num_views;
};

struct RowCount {
  int64_t points = 0, invalid = 0, inconsistent = 0, seen_through = 0, yielded = 0;
};

Eigen::Vector3d NormalAt(const float* normals, int64_t pixel, int64_t area) {
  return {normals[pixel], normals[pixel + area], normals[pixel + 2 * area]};
}

// Reads a run of pixels; false where none of them has a depth.
bool ReadRun(const DepthView& reference, const float* normals, int64_t row, int64_t column,
             int64_t end, fusion::Run* run, RowCount* count) {
  const int64_t area = reference.rectangle.Area();
  run->first_x = double(reference.rectangle.x0 + column);
  run->y = double(reference.rectangle.y0 + row);
  run->count = end - column;
  bool any = false;
  for (int64_t i = 0; i < run->count; ++i) {
    const int64_t pixel = row * reference.rectangle.width + column + i;
    const float depth = reference.depth[pixel];
    const bool is_depth = IsDepth(depth);
    any |= is_depth;
    count->invalid += !is_depth && depth != 0;
    run->inverse_depth[i] = is_depth ? 1.0 / depth : 0.0;
    run->deviation[i] =
        reference.sigma && is_depth
            ? double(reference.sigma[pixel]) * run->inverse_depth[i] * run->inverse_depth[i]
            : 1.0;
    for (int axis = 0; axis < 3; ++axis) run->normal[axis][i] = normals[pixel + axis * area];
  }
  return any;
}

// One more than needed must agree before a pixel trusts another view to emit its point.
bool Yields(const fusion::Run& run, int64_t i, int needed, const FusionOptions& options) {
  return run.has_better[i] > 0 && run.num_consistent[i] > needed && !options.keep_duplicates;
}

bool IsDecided(const fusion::Run& run, int needed, const FusionOptions& options) {
  for (int64_t i = 0; i < run.count; ++i) {
    if (run.inverse_depth[i] > 0 && !Yields(run, i, needed, options)) return false;
  }
  return true;
}

// Whether a pixel is the middle one of the pixel of the coarser level that its depth comes from.
bool StandsForItsLevel(const Rectangle& window, const ReferenceMaps& maps, int64_t row,
                       int64_t column) {
  const int level = maps.level ? maps.level[row * window.width + column] : 0;
  const int64_t inside = (int64_t(1) << level) - 1, middle = (int64_t(1) << level) / 2;
  return ((window.x0 + column) & inside) == middle && ((window.y0 + row) & inside) == middle;
}

// `sources` in the order in which they are asked.
RowCount FuseRow(const fusion::Kernels& kernels, const DepthView& reference,
                 const fusion::Reference& camera, const ReferenceMaps& maps,
                 const std::vector<AskedSource>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options, int64_t row, Fused* fused) {
  RowCount count;
  const Rectangle& window = reference.rectangle;
  const uint32_t* allowed_of_row =
      blocks.allowed + (window.y0 + row) / blocks.side * blocks.columns;
  const fusion::Limits limits = {options.consistency * options.consistency,
                                 options.yield_shift * options.yield_shift,
                                 options.see_through * options.see_through,
                                 options.agreement * options.agreement, options.yield_footprint};
  fusion::Run run;
  for (int64_t column = 0, end; column < window.width; column = end) {
    const int64_t block = (window.x0 + column) / blocks.side;
    end = std::min({window.width, column + fusion::kRun, (block + 1) * blocks.side - window.x0});
    if (!ReadRun(reference, maps.normal, row, column, end, &run, &count)) continue;
    kernels.begin(camera, &run);
    const uint32_t allowed = allowed_of_row[block];
    const int most = std::max(1, std::min(options.min_consistent, __builtin_popcount(allowed)));
    for (const AskedSource& source : sources) {
      if (!(allowed & source.bit)) continue;
      kernels.ask(source.kernel, limits, &run);
      if (IsDecided(run, most, options)) break;
    }
    for (int64_t i = 0; i < run.count; ++i) {
      if (!(run.inverse_depth[i] > 0)) continue;
      const int needed = std::max(1, std::min(most, int(run.num_seeing[i])));
      if (Yields(run, i, needed, options)) {
        ++count.yielded;
      } else if (run.num_close[i] < needed &&
                 run.num_consistent[i] <
                     std::min(needed + 1, std::max(1, int(run.num_seeing[i])))) {
        ++count.inconsistent;
      } else if (run.num_through[i] > run.num_consistent[i]) {
        ++count.seen_through;
      } else if (options.thin && !StandsForItsLevel(window, maps, row, column + i)) {
        ++count.yielded;
      } else {
        ++count.points;
        const size_t pixel = size_t(row * window.width + column + i);
        const double per_depth = run.sum_weight[i] / run.sum_inverse_depth[i];
        fused->depth[pixel] = per_depth;
        // What agrees has mistakes in common: as sure as one of them, not as their mean.
        const double count = run.num_consistent[i] + 1;
        fused->sigma[pixel] =
            reference.sigma ? float(std::sqrt(count / run.sum_weight[i]) * per_depth * per_depth)
                            : 0.f;
        fused->num_views[pixel] = uint8_t(run.num_consistent[i] + 1);
      }
    }
  }
  return count;
}

// The points of a row, from point `first` on.
void EmitRow(const DepthView& reference, const ReferenceCamera& camera, const ReferenceMaps& maps,
             const Fused& fused, int64_t row, int64_t first, FusedPoints* points) {
  const int64_t width = reference.rectangle.width, area = reference.rectangle.Area();
  const double focal = std::sqrt(camera.kernel.focal_area);
  int64_t next = first;
  for (int64_t column = 0; column < width; ++column) {
    const int64_t pixel = row * width + column;
    const double depth = fused.depth[size_t(pixel)];
    if (depth <= 0) continue;
    FusedPoint& point = points->points[size_t(next)];
    Eigen::Map<Eigen::Vector3d>(point.position) = camera.World(
        double(reference.rectangle.x0 + column), double(reference.rectangle.y0 + row), depth);
    Eigen::Map<Eigen::Vector3f>(point.normal) =
        (camera.world_from_cam * NormalAt(maps.normal, pixel, area)).normalized().cast<float>();
    for (int i = 0; i < 3; ++i) point.color[i] = maps.color ? maps.color[3 * pixel + i] : 0;
    point.num_views = fused.num_views[size_t(pixel)];
    point.confidence = maps.confidence ? maps.confidence[pixel] : 0;
    point.gsd = float(depth / focal);
    point.sigma = fused.sigma[size_t(pixel)];
    point.level = maps.level ? maps.level[pixel] : 0;
    points->pixel[size_t(next)] = pixel;
    ++next;
  }
}

void Check(const DepthView& reference, const std::vector<DepthView>& sources,
           const SourceBlocks& blocks) {
  const auto require = [](bool satisfied, const std::string& what) {
    if (!satisfied) throw std::invalid_argument("Fuse: " + what);
  };
  const int64_t side = blocks.side;
  require(side >= 1 && Rectangle{0, 0, side * blocks.columns, side * blocks.rows}.Contains(
                           reference.rectangle),
          "the blocks must cover the reference window");
  uint32_t named = 0;
  for (int i = 0; i < blocks.columns * blocks.rows; ++i) named |= blocks.allowed[i];
  require(sources.size() <= 32 && uint64_t(named) >> sources.size() == 0,
          "the blocks must allow sources 0 to " + std::to_string(sources.size()) +
              ", 32 at most, and no others");
}

}  // namespace

void FusionOptions::Validate() const {
  Require(min_consistent >= 1, "min_consistent", min_consistent, ">= 1");
  Require(consistency > 0, "consistency", consistency, "> 0");
  Require(agreement >= 0, "agreement", agreement, ">= 0");
  Require(yield_shift >= 0, "yield_shift", yield_shift, ">= 0");
  Require(yield_footprint > 0, "yield_footprint", yield_footprint, "> 0");
  Require(see_through > 0, "see_through", see_through, "> 0");
  Require(threads >= 0, "threads", threads, ">= 0");
}

FusedPoints Fuse(const DepthView& reference, const ReferenceMaps& maps,
                 const std::vector<DepthView>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options) {
  options.Validate();
  Check(reference, sources, blocks);
  const ReferenceCamera camera(reference);
  std::vector<AskedSource> asked;
  asked.reserve(sources.size());  // kernels point into them
  for (size_t i = 0; i < sources.size(); ++i) {
    if (sources[i].depth) asked.emplace_back(camera, reference, sources[i], 1u << i);
  }
  // Those that a pixel may leave its point to come first: then it need not ask the others.
  std::stable_sort(asked.begin(), asked.end(),
                   [](const AskedSource& a, const AskedSource& b) { return a.rank < b.rank; });

  // Nothing is allocated inside the parallel loops: running out of memory there would end the
  // process.
  const fusion::Kernels& kernels = BestKernels();
  const int64_t height = reference.rectangle.height;
  const size_t area = size_t(reference.rectangle.Area());
  Fused fused{std::vector<double>(area), std::vector<float>(area), std::vector<uint8_t>(area)};
  std::vector<RowCount> counts(height);
  const int threads = options.threads > 0 ? options.threads : omp_get_num_procs();
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int64_t y = 0; y < height; ++y) {
    counts[size_t(y)] =
        FuseRow(kernels, reference, camera.kernel, maps, asked, blocks, options, y, &fused);
  }
  asked.clear();

  FusedPoints points;
  std::vector<int64_t> first(height);
  int64_t count = 0;
  for (int64_t y = 0; y < height; ++y) {
    first[size_t(y)] = count;
    count += counts[size_t(y)].points;
    points.num_invalid += counts[size_t(y)].invalid;
    points.num_inconsistent += counts[size_t(y)].inconsistent;
    points.num_seen_through += counts[size_t(y)].seen_through;
    points.num_yielded += counts[size_t(y)].yielded;
  }
  points.points.resize(count);
  points.pixel.resize(count);
#pragma omp parallel for num_threads(threads)
  for (int64_t y = 0; y < height; ++y) {
    EmitRow(reference, camera, maps, fused, y, first[size_t(y)], &points);
  }
  return points;
}

}  // namespace sirpy
