#include <optional>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "depth_filter.h"
#include "patch_match/level.h"
#include "patch_match_sir.h"

namespace py = pybind11;

namespace sirpy {
namespace {

// A ViewWindow that keeps its arrays alive.
struct OwnedViewWindow {
  ViewWindow view;
  Array<uint8_t> grey;
  std::optional<Array<float>> depth;
  std::optional<Array<float>> normal;
};

OwnedViewWindow MakeViewWindow(const Eigen::Matrix3d& intrinsics, const Pose& cam_from_world,
                               int64_t x0, int64_t y0, Array<uint8_t> grey,
                               std::optional<Array<float>> depth,
                               std::optional<Array<float>> normal) {
  CheckDimensions(grey, 2, "grey");
  const auto check = [&](const auto& array, const char* name, int dimensions) {
    CheckDimensions(array, dimensions, name);
    if (array.shape(dimensions - 2) != grey.shape(0) ||
        array.shape(dimensions - 1) != grey.shape(1)) {
      throw py::value_error(std::string(name) + " must have the size of grey");
    }
  };
  OwnedViewWindow owned;
  owned.view.intrinsics = intrinsics;
  owned.view.rotation = cam_from_world.leftCols<3>();
  owned.view.translation = cam_from_world.col(3);
  owned.view.rectangle = {x0, y0, grey.shape(1), grey.shape(0)};
  owned.view.grey = grey.data();
  if (depth) {
    check(*depth, "depth", 2);
    owned.view.depth = depth->data();
  }
  if (normal) {
    check(*normal, "normal", 3);
    if (normal->shape(0) != 3) throw py::value_error("normal must have 3 planes");
    owned.view.normal = normal->data();
  }
  owned.grey = std::move(grey);
  owned.depth = std::move(depth);
  owned.normal = std::move(normal);
  return owned;
}

py::tuple RunPatchMatch(const OwnedViewWindow& reference,
                        const std::vector<OwnedViewWindow>& sources, const Array<double>& points,
                        const PatchMatchOptions& options) {
  CheckDimensions(points, 2, "points");
  if (points.shape(1) != 3) throw py::value_error("points must have 3 columns: x, y, depth");
  std::vector<SparsePoint> sparse;
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    sparse.push_back({points.at(i, 0), points.at(i, 1), points.at(i, 2)});
  }
  std::vector<ViewWindow> views;
  for (const OwnedViewWindow& source : sources) views.push_back(source.view);
  PatchMatchResult result;
  {
    py::gil_scoped_release release;
    result = PatchMatchSir(reference.view, views, sparse, options);
  }
  const py::ssize_t height = reference.view.rectangle.height,
                    width = reference.view.rectangle.width;
  return py::make_tuple(ToArray(std::move(result.depth), {height, width}),
                        ToArray(std::move(result.normal), {3, height, width}),
                        ToArray(std::move(result.cost), {height, width}),
                        ToArray(std::move(result.num_seeing), {height, width}),
                        ToArray(std::move(result.num_consistent), {height, width}));
}

PlaneMap MakePlaneMap(const Array<float>& depth, const Array<float>& normal,
                      const Eigen::Matrix3d& intrinsics, int64_t x0, int64_t y0) {
  CheckDimensions(depth, 2, "depth");
  CheckDimensions(normal, 3, "normal");
  const py::ssize_t height = depth.shape(0), width = depth.shape(1);
  if (normal.shape(0) != 3 || normal.shape(1) != height || normal.shape(2) != width) {
    throw py::value_error("normal must have 3 planes of the size of depth");
  }
  return {{x0, y0, width, height}, intrinsics, depth.data(), normal.data()};
}

py::array_t<uint8_t> RunFindSpeckles(const Array<float>& depth, const Array<float>& normal,
                                     const Eigen::Matrix3d& intrinsics, int64_t x0, int64_t y0,
                                     double step, int64_t min_pixels) {
  const PlaneMap map = MakePlaneMap(depth, normal, intrinsics, x0, y0);
  std::vector<uint8_t> speckle;
  {
    py::gil_scoped_release release;
    speckle = FindSpeckles(map, {step, min_pixels});
  }
  return ToArray(std::move(speckle), {depth.shape(0), depth.shape(1)});
}

py::array_t<float> RunCoplanarShares(const Array<float>& depth, const Array<float>& normal,
                                     const Eigen::Matrix3d& intrinsics, int64_t x0, int64_t y0) {
  const PlaneMap map = MakePlaneMap(depth, normal, intrinsics, x0, y0);
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
      .def_readwrite("min_depth", &PatchMatchOptions::min_depth)
      .def_readwrite("max_depth", &PatchMatchOptions::max_depth)
      .def_readwrite("levels", &PatchMatchOptions::levels)
      .def_readwrite("coarsest_iterations", &PatchMatchOptions::coarsest_iterations)
      .def_readwrite("middle_iterations", &PatchMatchOptions::middle_iterations)
      .def_readwrite("native_iterations", &PatchMatchOptions::native_iterations)
      .def_readwrite("geometric_iterations", &PatchMatchOptions::geometric_iterations)
      .def_readwrite("native_offers", &PatchMatchOptions::native_offers)
      .def_readwrite("top_views", &PatchMatchOptions::top_views)
      .def_readwrite("color_sigma", &PatchMatchOptions::color_sigma)
      .def_readwrite("space_sigma", &PatchMatchOptions::space_sigma)
      .def_readwrite("geometric_weight", &PatchMatchOptions::geometric_weight)
      .def_readwrite("max_geometric_error", &PatchMatchOptions::max_geometric_error)
      .def_readwrite("consistency", &PatchMatchOptions::consistency)
      .def_readwrite("prior_variance", &PatchMatchOptions::prior_variance)
      .def_readwrite("seed", &PatchMatchOptions::seed)
      .def_readwrite("threads", &PatchMatchOptions::threads)
      .def("validate", &PatchMatchOptions::Validate);

  py::class_<OwnedViewWindow>(module, "ViewWindow")
      .def(py::init(&MakeViewWindow), py::kw_only(), py::arg("intrinsics"),
           py::arg("cam_from_world"), py::arg("x0"), py::arg("y0"), py::arg("grey").noconvert(),
           py::arg("depth").noconvert() = py::none(), py::arg("normal").noconvert() = py::none());

  module.def("patch_match", &RunPatchMatch, py::arg("reference"), py::arg("sources"),
             py::arg("points").noconvert(), py::arg("options"));
  module.def("patch_match_bytes_per_pixel", [](bool geometric) {
    const PatchMatchMemory memory = PatchMatchBytesPerPixel(geometric);
    return py::make_tuple(memory.per_reference_pixel, memory.per_source_pixel);
  });
  module.def("find_speckles", &RunFindSpeckles, py::arg("depth").noconvert(),
             py::arg("normal").noconvert(), py::kw_only(), py::arg("intrinsics"), py::arg("x0"),
             py::arg("y0"), py::arg("step"), py::arg("min_pixels"));
  module.def("coplanar_shares", &RunCoplanarShares, py::arg("depth").noconvert(),
             py::arg("normal").noconvert(), py::kw_only(), py::arg("intrinsics"), py::arg("x0"),
             py::arg("y0"));
  module.def("instruction_set", [] { return patch_match::BestKernels().name; });
}

}  // namespace sirpy
