#include <optional>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "fusion.h"

namespace py = pybind11;

namespace sirpy {
namespace {

// A DepthView that keeps its array alive.
struct OwnedDepthView {
  DepthView view;
  Array<float> depth;
};

OwnedDepthView MakeDepthView(const Eigen::Matrix3d& intrinsics, const Pose& cam_from_world,
                             int64_t x0, int64_t y0, int rank, Array<float> depth) {
  CheckDimensions(depth, 2, "depth");
  OwnedDepthView owned;
  owned.view.intrinsics = intrinsics;
  owned.view.rotation = cam_from_world.leftCols<3>();
  owned.view.translation = cam_from_world.col(3);
  owned.view.rectangle = {x0, y0, depth.shape(1), depth.shape(0)};
  owned.view.rank = rank;
  owned.view.depth = depth.data();
  owned.depth = std::move(depth);
  return owned;
}

py::tuple RunFuse(const OwnedDepthView& reference, const Array<float>& normal,
                  const std::vector<std::optional<OwnedDepthView>>& sources, int block_side,
                  const Array<uint32_t>& allowed, const FusionOptions& options) {
  CheckPlanes(normal, reference.depth.shape(0), reference.depth.shape(1), "normal",
              "the reference's depth");
  CheckDimensions(allowed, 2, "allowed");
  const SourceBlocks blocks{block_side, int(allowed.shape(1)), int(allowed.shape(0)),
                            allowed.data()};
  std::vector<DepthView> views;
  for (const auto& source : sources) views.push_back(source ? source->view : DepthView{});
  FusedPoints points;
  {
    py::gil_scoped_release release;
    points = Fuse(reference.view, normal.data(), views, blocks, options);
  }
  const auto count = py::ssize_t(points.pixel.size());
  return py::make_tuple(
      ToArray(std::move(points.position), {count, 3}),
      ToArray(std::move(points.normal), {count, 3}), ToArray(std::move(points.pixel), {count}),
      ToArray(std::move(points.num_views), {count}), points.num_inconsistent, points.num_yielded);
}

}  // namespace

void BindFusion(py::module_& module) {
  py::class_<FusionOptions>(module, "FusionOptions")
      .def(py::init<>())
      .def_readwrite("min_consistent", &FusionOptions::min_consistent)
      .def_readwrite("consistency", &FusionOptions::consistency)
      .def_readwrite("yield_shift", &FusionOptions::yield_shift)
      .def_readwrite("yield_footprint", &FusionOptions::yield_footprint)
      .def_readwrite("keep_duplicates", &FusionOptions::keep_duplicates)
      .def_readwrite("threads", &FusionOptions::threads)
      .def("validate", &FusionOptions::Validate);

  py::class_<OwnedDepthView>(module, "DepthView")
      .def(py::init(&MakeDepthView), py::kw_only(), py::arg("intrinsics"),
           py::arg("cam_from_world"), py::arg("x0"), py::arg("y0"), py::arg("rank"),
           py::arg("depth").noconvert());

  module.def("fuse", &RunFuse, py::arg("reference"), py::arg("normal").noconvert(),
             py::arg("sources"), py::kw_only(), py::arg("block_side"),
             py::arg("allowed").noconvert(), py::arg("options"));
}

}  // namespace sirpy
