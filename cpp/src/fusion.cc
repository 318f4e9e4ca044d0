#include "fusion.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include <Eigen/Geometry>
#include <Eigen/LU>

#include "depth_window.h"
#include "option_bounds.h"

namespace sirpy {
namespace {

void Require(bool satisfied, const std::string& field, double value,
             const std::string& constraint) {
  RequireOption(satisfied, "FusionOptions", field, value, field + " " + constraint);
}

// A camera whose pixel centres are at whole numbers, and the window of inverse depths.
struct Camera {
  explicit Camera(const DepthView& view)
      : intrinsics(view.intrinsics),
        rotation(view.rotation),
        translation(view.translation),
        centre(-view.rotation.transpose() * view.translation),
        window(view.rectangle),
        rank(view.rank) {
    intrinsics(0, 2) -= 0.5;
    intrinsics(1, 2) -= 0.5;
    inverse_intrinsics = intrinsics.inverse();
    inverse_depth.resize(size_t(window.Area()));
    for (size_t i = 0; i < inverse_depth.size(); ++i) {
      inverse_depth[i] = view.depth[i] > 0 ? 1 / view.depth[i] : 0;
    }
  }

  Eigen::Vector3d World(double x, double y, double depth) const {
    return rotation.transpose() *
           (inverse_intrinsics * Eigen::Vector3d(x, y, 1) * depth - translation);
  }
  Eigen::Vector3d InCamera(const Eigen::Vector3d& world) const {
    return rotation * world + translation;
  }

  // Area of the surface with that normal that one pixel covers at the world point, up to a
  // constant.
  double Footprint(const Eigen::Vector3d& world, const Eigen::Vector3d& normal) const {
    const Eigen::Vector3d ray = world - centre;
    const double depth = InCamera(world).z();
    const double facing = std::abs(ray.dot(normal)) / depth;
    return depth * depth / (intrinsics(0, 0) * intrinsics(1, 1) * std::max(facing, 1e-3));
  }

  Eigen::Matrix3d intrinsics, inverse_intrinsics, rotation;
  Eigen::Vector3d translation, centre;
  Rectangle window;
  int rank;
  std::vector<float> inverse_depth;
};

struct Agreement {
  double shift;  // pixels, forward-backward
  double depth;  // what the source measures along the reference's ray
};

// The plane of the reference's pixel: inverse depth is m . (x, y, 1).
Eigen::Vector3d InverseDepthPlane(const Camera& reference, const Eigen::Vector3d& normal, double x,
                                  double y, double depth) {
  const Eigen::Vector3d m = reference.inverse_intrinsics.transpose() * normal;
  const double at_pixel = m.dot(Eigen::Vector3d(x, y, 1));
  if (std::abs(at_pixel) < 1e-9) return {0, 0, 1 / depth};
  return m / (at_pixel * depth);
}

std::optional<Agreement> Agree(const Camera& reference, const Camera& source, double x, double y,
                               const Eigen::Vector3d& world, const Eigen::Vector3d& plane) {
  const Eigen::Vector3d in_source = source.InCamera(world);
  if (in_source.z() <= 0) return std::nullopt;
  const Eigen::Vector2d at = (source.intrinsics * in_source).hnormalized();
  // Bounds are tested in the precision that indices are computed in. Rounded before the window's
  // origin is taken off, which is exact: the window has no part in it.
  const float u = float(at.x()) - float(source.window.x0);
  const float v = float(at.y()) - float(source.window.y0);
  if (!(u >= 0 && v >= 0 && u < float(source.window.width - 1) &&
        v < float(source.window.height - 1))) {
    return std::nullopt;
  }
  const float rho =
      InterpolatedInverseDepth(source.inverse_depth.data(), int(source.window.width), u, v);
  if (rho <= 0) return std::nullopt;
  const Eigen::Vector3d back = reference.InCamera(source.World(at.x(), at.y(), 1.0 / rho));
  if (back.z() <= 0) return std::nullopt;
  const Eigen::Vector2d where = (reference.intrinsics * back).hnormalized();
  const Eigen::Vector2d step = where - Eigen::Vector2d(x, y);
  // The source's point lies beside the ray: slide it along the surface onto the ray.
  const double on_ray = 1 / back.z() - plane.head<2>().dot(step);
  if (on_ray <= 0) return std::nullopt;
  return Agreement{step.norm(), 1 / on_ray};
}

// What a pixel gives: nothing, or a point at the mean depth.
struct Fused {
  std::vector<double> depth;  // 0 where there is no point
  std::vector<uint8_t> num_views;
};

struct RowCount {
  int64_t points = 0, inconsistent = 0, yielded = 0;
};

Eigen::Vector3d NormalAt(const float* normals, int64_t pixel, int64_t area) {
  return {normals[pixel], normals[pixel + area], normals[pixel + 2 * area]};
}

RowCount FuseRow(const Camera& reference, const float* normals,
                 const std::vector<std::optional<Camera>>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options, int64_t row, Fused* fused) {
  RowCount count;
  const int64_t width = reference.window.width, area = reference.window.Area();
  const uint32_t* allowed_of_row =
      blocks.allowed + (reference.window.y0 + row) / blocks.side * blocks.columns;
  for (int64_t column = 0; column < width; ++column) {
    const int64_t pixel = row * width + column;
    const float rho = reference.inverse_depth[size_t(pixel)];
    if (rho <= 0) continue;
    const double depth = 1.0 / rho;
    const double x = double(reference.window.x0 + column), y = double(reference.window.y0 + row);
    const Eigen::Vector3d normal = NormalAt(normals, pixel, area);
    const Eigen::Vector3d world_normal = reference.rotation.transpose() * normal;
    const Eigen::Vector3d world = reference.World(x, y, depth);
    const Eigen::Vector3d plane = InverseDepthPlane(reference, normal, x, y, depth);

    int num_consistent = 0;
    double sum_inverse_depth = 1 / depth;
    bool better_view = false;
    const uint32_t allowed = allowed_of_row[(reference.window.x0 + column) / blocks.side];
    const int needed = std::max(1, std::min(options.min_consistent, __builtin_popcount(allowed)));
    for (uint32_t left = allowed; left != 0; left &= left - 1) {
      if (!sources[__builtin_ctz(left)]) continue;
      const Camera& source = *sources[__builtin_ctz(left)];
      const std::optional<Agreement> agreement = Agree(reference, source, x, y, world, plane);
      if (!agreement || agreement->shift >= options.consistency) continue;
      ++num_consistent;
      sum_inverse_depth += 1 / agreement->depth;
      better_view =
          better_view || (source.rank < reference.rank && agreement->shift < options.yield_shift &&
                          source.Footprint(world, world_normal) <
                              options.yield_footprint * reference.Footprint(world, world_normal));
    }
    if (num_consistent < needed) {
      ++count.inconsistent;
      continue;
    }
    // One more than needed must agree before a pixel trusts another view to emit its point.
    if (better_view && num_consistent > needed && !options.keep_duplicates) {
      ++count.yielded;
      continue;
    }
    ++count.points;
    fused->depth[size_t(pixel)] = double(num_consistent + 1) / sum_inverse_depth;
    fused->num_views[size_t(pixel)] = uint8_t(num_consistent + 1);
  }
  return count;
}

// The points of a row, from point `first` on.
void EmitRow(const Camera& reference, const float* normals, const Fused& fused, int64_t row,
             int64_t first, FusedPoints* points) {
  const int64_t width = reference.window.width, area = reference.window.Area();
  int64_t point = first;
  for (int64_t column = 0; column < width; ++column) {
    const int64_t pixel = row * width + column;
    const double depth = fused.depth[size_t(pixel)];
    if (depth <= 0) continue;
    const Eigen::Vector3d position = reference.World(double(reference.window.x0 + column),
                                                     double(reference.window.y0 + row), depth);
    const Eigen::Vector3d world_normal =
        reference.rotation.transpose() * NormalAt(normals, pixel, area);
    Eigen::Map<Eigen::Vector3d>(&points->position[size_t(3 * point)]) = position;
    Eigen::Map<Eigen::Vector3f>(&points->normal[size_t(3 * point)]) =
        world_normal.normalized().cast<float>();
    points->pixel[size_t(point)] = pixel;
    points->num_views[size_t(point)] = fused.num_views[size_t(pixel)];
    ++point;
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
  Require(yield_shift >= 0, "yield_shift", yield_shift, ">= 0");
  Require(yield_footprint > 0, "yield_footprint", yield_footprint, "> 0");
  Require(threads >= 0, "threads", threads, ">= 0");
}

FusedPoints Fuse(const DepthView& reference, const float* normal,
                 const std::vector<DepthView>& sources, const SourceBlocks& blocks,
                 const FusionOptions& options) {
  options.Validate();
  Check(reference, sources, blocks);
  const Camera reference_camera(reference);
  std::vector<std::optional<Camera>> source_cameras;
  for (const DepthView& source : sources) {
    source_cameras.push_back(source.depth ? std::make_optional<Camera>(source) : std::nullopt);
  }

  // Nothing is allocated inside the parallel loops: running out of memory there would end the
  // process.
  const int64_t height = reference.rectangle.height;
  const size_t area = size_t(reference.rectangle.Area());
  Fused fused{std::vector<double>(area), std::vector<uint8_t>(area)};
  std::vector<RowCount> counts(height);
  const int threads = options.threads > 0 ? options.threads : omp_get_num_procs();
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int64_t y = 0; y < height; ++y) {
    counts[size_t(y)] =
        FuseRow(reference_camera, normal, source_cameras, blocks, options, y, &fused);
  }
  source_cameras.clear();

  FusedPoints points;
  std::vector<int64_t> first(height);
  int64_t count = 0;
  for (int64_t y = 0; y < height; ++y) {
    first[size_t(y)] = count;
    count += counts[size_t(y)].points;
    points.num_inconsistent += counts[size_t(y)].inconsistent;
    points.num_yielded += counts[size_t(y)].yielded;
  }
  points.position.resize(3 * count);
  points.normal.resize(3 * count);
  points.pixel.resize(count);
  points.num_views.resize(count);
#pragma omp parallel for num_threads(threads)
  for (int64_t y = 0; y < height; ++y) {
    EmitRow(reference_camera, normal, fused, y, first[size_t(y)], &points);
  }
  return points;
}

}  // namespace sirpy
