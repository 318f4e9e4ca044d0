#include <optional>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "depth_filter.h"
#include "patch_match/level.h"
#include "patch_match/planar_completion.h"
#include "patch_match/pyramid.h"
#include "patch_match_sir.h"

namespace py = pybind11;

namespace sirpy {
namespace {

// A ViewWindow that keeps its arrays alive.
struct OwnedViewWindow {
  ViewWindow view;
  Array<uint8_t> grey;
  std::optional<Array<float>> inverse_depth, deviation;
};

OwnedViewWindow MakeViewWindow(const Eigen::Matrix3d& intrinsics, const Pose& cam_from_world,
                               int level, int64_t x0, int64_t y0, Array<uint8_t> grey,
                               std::optional<Array<float>> inverse_depth,
                               std::optional<Array<float>> deviation) {
  CheckDimensions(grey, 2, "grey");
  OwnedViewWindow owned;
  owned.view.intrinsics = intrinsics;
  owned.view.rotation = cam_from_world.leftCols<3>();
  owned.view.translation = cam_from_world.col(3);
  owned.view.level = level;
  owned.view.rectangle = {x0, y0, grey.shape(1), grey.shape(0)};
  owned.view.grey = grey.data();
  if (inverse_depth) {
    CheckMap(*inverse_depth, grey.shape(0), grey.shape(1), "inverse_depth", "grey");
    owned.view.inverse_depth = inverse_depth->data();
  }
  if (deviation) {
    CheckMap(*deviation, grey.shape(0), grey.shape(1), "deviation", "grey");
    owned.view.deviation = deviation->data();
  }
  owned.grey = std::move(grey);
  owned.deviation = std::move(deviation);
  owned.inverse_depth = std::move(inverse_depth);
  return owned;
}

struct OwnedStartMaps {
  StartMaps maps;
  Array<float> depth, normal;
  Array<uint32_t> views;
  std::optional<Array<float>> sigma;
  std::optional<Array<uint8_t>> level_of;
};

OwnedStartMaps MakeStartMaps(int level, int64_t x0, int64_t y0, Array<float> depth,
                             Array<float> normal, Array<uint32_t> views,
                             std::optional<Array<float>> sigma,
                             std::optional<Array<uint8_t>> level_of) {
  CheckDimensions(depth, 2, "depth");
  const py::ssize_t height = depth.shape(0), width = depth.shape(1);
  CheckPlanes(normal, height, width, "normal", "depth");
  CheckMap(views, height, width, "views", "depth");
  OwnedStartMaps owned;
  if (sigma.has_value() != level_of.has_value()) {
    throw py::value_error("sigma and level_of must be given together");
  }
  if (sigma) {
    CheckMap(*sigma, height, width, "sigma", "depth");
    CheckMap(*level_of, height, width, "level_of", "depth");
  }
  owned.maps = {level,
                {x0, y0, width, height},
                depth.data(),
                normal.data(),
                views.data(),
                sigma ? sigma->data() : nullptr,
                level_of ? level_of->data() : nullptr};
  owned.sigma = std::move(sigma);
  owned.level_of = std::move(level_of);
  owned.depth = std::move(depth);
  owned.normal = std::move(normal);
  owned.views = std::move(views);
  return owned;
}

py::dict RunPatchMatch(const OwnedViewWindow& reference,
                       const std::vector<std::optional<OwnedViewWindow>>& sources, int block_side,
                       const Array<uint32_t>& allowed, const Array<float>& min_depth,
                       const Array<float>& max_depth, const Array<double>& points,
                       const std::optional<OwnedStartMaps>& start,
                       const PatchMatchOptions& options) {
  CheckDimensions(points, 2, "points");
  if (points.shape(1) != 3) throw py::value_error("points must have 3 columns: x, y, depth");
  std::vector<SparsePoint> sparse;
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    sparse.push_back({points.at(i, 0), points.at(i, 1), points.at(i, 2)});
  }
  CheckDimensions(allowed, 2, "allowed");
  CheckMap(min_depth, allowed.shape(0), allowed.shape(1), "min_depth", "allowed");
  CheckMap(max_depth, allowed.shape(0), allowed.shape(1), "max_depth", "allowed");
  const ViewBlocks blocks{block_side,     int(allowed.shape(1)), int(allowed.shape(0)),
                          allowed.data(), min_depth.data(),      max_depth.data()};
  std::vector<ViewWindow> views;
  for (const auto& source : sources) views.push_back(source ? source->view : ViewWindow{});
  PatchMatchResult result;
  {
    py::gil_scoped_release release;
    result = PatchMatchSir(reference.view, views, blocks, sparse, start ? &start->maps : nullptr,
                           options);
  }
  const py::ssize_t height = reference.view.rectangle.height,
                    width = reference.view.rectangle.width;
  py::dict maps;
  maps["depth"] = ToArray(std::move(result.depth), {height, width});
  maps["normal"] = ToArray(std::move(result.normal), {3, height, width});
  maps["views"] = ToArray(std::move(result.views), {height, width});
  maps["cost"] = ToArray(std::move(result.cost), {height, width});
  maps["texture"] = ToArray(std::move(result.texture), {height, width});
  maps["num_seeing"] = ToArray(std::move(result.num_seeing), {height, width});
  maps["sigma"] = ToArray(std::move(result.sigma), {height, width});
  maps["motion"] = ToArray(std::move(result.motion), {height, width});
  maps["level"] = ToArray(std::move(result.level), {height, width});
  maps["num_consistent"] = ToArray(std::move(result.num_consistent), {height, width});
  return maps;
}

py::tuple RunCompletePlanes(int level, int64_t x0, int64_t y0, const Eigen::Matrix3d& intrinsics,
                            const Array<uint8_t>& grey, const Array<float>& depth,
                            const Array<float>& normal, const Array<uint32_t>& views,
                            const Array<float>& texture, const Array<uint8_t>& num_consistent,
                            const Array<double>& source_centres,
                            const PlanarCompletionOptions& options) {
  CheckDimensions(source_centres, 2, "source_centres");
  if (source_centres.shape(1) != 3) throw py::value_error("source_centres must have 3 columns");
  std::vector<Eigen::Vector3d> centres;
  for (py::ssize_t i = 0; i < source_centres.shape(0); ++i) {
    centres.emplace_back(source_centres.at(i, 0), source_centres.at(i, 1), source_centres.at(i, 2));
  }
  CheckDimensions(grey, 2, "grey");
  const py::ssize_t height = grey.shape(0), width = grey.shape(1);
  CheckMap(depth, height, width, "depth", "grey");
  CheckMap(views, height, width, "views", "grey");
  CheckMap(texture, height, width, "texture", "grey");
  CheckMap(num_consistent, height, width, "num_consistent", "grey");
  CheckPlanes(normal, height, width, "normal", "grey");
  const CompletionMaps maps{level,
                            {x0, y0, width, height},
                            intrinsics,
                            grey.data(),
                            depth.data(),
                            normal.data(),
                            views.data(),
                            texture.data(),
                            num_consistent.data()};
  PlanarCompletion result;
  {
    py::gil_scoped_release release;
    result = CompletePlanes(maps, centres, options);
  }
  return py::make_tuple(ToArray(std::move(result.depth), {height, width}),
                        ToArray(std::move(result.normal), {3, height, width}),
                        ToArray(std::move(result.completed), {height, width}));
}

PlaneMap MakePlaneMap(const Array<float>& depth, const Array<float>& normal,
                      const Array<float>& sigma, const Eigen::Matrix3d& intrinsics, int64_t x0,
                      int64_t y0) {
  CheckDimensions(depth, 2, "depth");
  const py::ssize_t height = depth.shape(0), width = depth.shape(1);
  CheckPlanes(normal, height, width, "normal", "depth");
  CheckMap(sigma, height, width, "sigma", "depth");
  return {{x0, y0, width, height}, intrinsics, depth.data(), normal.data(), sigma.data()};
}

py::array_t<uint8_t> RunFindSpeckles(const Array<float>& depth, const Array<float>& normal,
                                     const Array<float>& sigma, const Eigen::Matrix3d& intrinsics,
                                     int64_t x0, int64_t y0, double step, double deviations,
                                     int64_t min_pixels) {
  const PlaneMap map = MakePlaneMap(depth, normal, sigma, intrinsics, x0, y0);
  std::vector<uint8_t> speckle;
  {
    py::gil_scoped_release release;
    speckle = FindSpeckles(map, {step, deviations, min_pixels});
  }
  return ToArray(std::move(speckle), {depth.shape(0), depth.shape(1)});
}

py::array_t<float> RunCoplanarShares(const Array<float>& depth, const Array<float>& normal,
                                     const Array<float>& sigma, const Eigen::Matrix3d& intrinsics,
                                     int64_t x0, int64_t y0) {
  const PlaneMap map = MakePlaneMap(depth, normal, sigma, intrinsics, x0, y0);
  std::vector<float> shares;
  {
    py::gil_scoped_release release;
    shares = CoplanarShares(map);
  }
  return ToArray(std::move(shares), {depth.shape(0), depth.shape(1)});
}

}  // namespace

void BindStereo(py::module_& module) {
  py::class_<PatchMatchOptions>(module, "PatchMatchOptions")
      .def(py::init<>())
      .def_readwrite("iterations", &PatchMatchOptions::iterations)
      .def_readwrite("offers", &PatchMatchOptions::offers)
      .def_readwrite("largest_step", &PatchMatchOptions::largest_step)
      .def_readwrite("top_views", &PatchMatchOptions::top_views)
      .def_readwrite("color_sigma", &PatchMatchOptions::color_sigma)
      .def_readwrite("space_sigma", &PatchMatchOptions::space_sigma)
      .def_readwrite("geometric_weight", &PatchMatchOptions::geometric_weight)
      .def_readwrite("max_geometric_error", &PatchMatchOptions::max_geometric_error)
      .def_readwrite("consistency", &PatchMatchOptions::consistency)
      .def_readwrite("agreement", &PatchMatchOptions::agreement)
      .def_readwrite("prior_weight", &PatchMatchOptions::prior_weight)
      .def_readwrite("noise", &PatchMatchOptions::noise)
      .def_readwrite("everywhere", &PatchMatchOptions::everywhere)
      .def_readwrite("seed", &PatchMatchOptions::seed)
      .def_readwrite("threads", &PatchMatchOptions::threads)
      .def("validate", &PatchMatchOptions::Validate);

  py::class_<PlanarCompletionOptions>(module, "PlanarCompletionOptions")
      .def(py::init<>())
      .def_readwrite("grey_step", &PlanarCompletionOptions::grey_step)
      .def_readwrite("weak_texture", &PlanarCompletionOptions::weak_texture)
      .def_readwrite("edge_texture", &PlanarCompletionOptions::edge_texture)
      .def_readwrite("min_consistent", &PlanarCompletionOptions::min_consistent)
      .def_readwrite("tolerance", &PlanarCompletionOptions::tolerance)
      .def_readwrite("min_share", &PlanarCompletionOptions::min_share)
      .def_readwrite("min_samples", &PlanarCompletionOptions::min_samples)
      .def_readwrite("max_error", &PlanarCompletionOptions::max_error)
      .def_readwrite("rounds", &PlanarCompletionOptions::rounds)
      .def_readwrite("threads", &PlanarCompletionOptions::threads);

  py::class_<OwnedViewWindow>(module, "ViewWindow")
      .def(py::init(&MakeViewWindow), py::kw_only(), py::arg("intrinsics"),
           py::arg("cam_from_world"), py::arg("level"), py::arg("x0"), py::arg("y0"),
           py::arg("grey").noconvert(), py::arg("inverse_depth").noconvert() = py::none(),
           py::arg("deviation").noconvert() = py::none());
  py::class_<OwnedStartMaps>(module, "StartMaps")
      .def(py::init(&MakeStartMaps), py::kw_only(), py::arg("level"), py::arg("x0"), py::arg("y0"),
           py::arg("depth").noconvert(), py::arg("normal").noconvert(),
           py::arg("views").noconvert(), py::arg("sigma").noconvert() = py::none(),
           py::arg("level_of").noconvert() = py::none());

  module.def("patch_match", &RunPatchMatch, py::kw_only(), py::arg("reference"), py::arg("sources"),
             py::arg("block_side"), py::arg("allowed").noconvert(),
             py::arg("min_depth").noconvert(), py::arg("max_depth").noconvert(),
             py::arg("points").noconvert(), py::arg("start"), py::arg("options"));
  module.def("complete_planes", &RunCompletePlanes, py::kw_only(), py::arg("level"), py::arg("x0"),
             py::arg("y0"), py::arg("intrinsics"), py::arg("grey").noconvert(),
             py::arg("depth").noconvert(), py::arg("normal").noconvert(),
             py::arg("views").noconvert(), py::arg("texture").noconvert(),
             py::arg("num_consistent").noconvert(), py::arg("source_centres").noconvert(),
             py::arg("options"));
  module.attr("PLANAR_COMPLETION_MARGIN") = kPlanarCompletionMargin;
  module.def("patch_match_margin", &PatchMatchMargin, py::arg("iterations"));
  module.def(
      "shrunk",
      [](const Array<uint8_t>& grey, int factor) {
        CheckDimensions(grey, 2, "grey");
        if (factor < 1) throw py::value_error("factor must be 1 or more");
        const int height = int(grey.shape(0)), width = int(grey.shape(1));
        return ToArray(patch_match::Shrunk(grey.data(), width, height, factor),
                       {(height + factor - 1) / factor, (width + factor - 1) / factor});
      },
      py::arg("grey").noconvert(), py::arg("factor"));
  module.def("patch_match_bytes_per_pixel", [] {
    const PatchMatchMemory memory = PatchMatchBytesPerPixel();
    return py::make_tuple(memory.per_reference_pixel, memory.per_source_pixel,
                          memory.per_reference_pixel_at_end);
  });
  module.def("find_speckles", &RunFindSpeckles, py::arg("depth").noconvert(),
             py::arg("normal").noconvert(), py::arg("sigma").noconvert(), py::kw_only(),
             py::arg("intrinsics"), py::arg("x0"), py::arg("y0"), py::arg("step"),
             py::arg("deviations"), py::arg("min_pixels"));
  module.def("coplanar_shares", &RunCoplanarShares, py::arg("depth").noconvert(),
             py::arg("normal").noconvert(), py::arg("sigma").noconvert(), py::kw_only(),
             py::arg("intrinsics"), py::arg("x0"), py::arg("y0"));
  module.def(
      "box_means",
      [](const Array<float>& plane, int radius) {
        CheckDimensions(plane, 2, "plane");
        if (radius < 0) throw py::value_error("radius must be 0 or more");
        const int64_t height = plane.shape(0), width = plane.shape(1);
        std::vector<float> means;
        {
          py::gil_scoped_release release;
          means = BoxMeans(plane.data(), width, height, radius);
        }
        return ToArray(std::move(means), {height, width});
      },
      py::arg("plane").noconvert(), py::arg("radius"));
  module.def("instruction_set", [] { return patch_match::BestKernels().name; });
}

}  // namespace sirpy
