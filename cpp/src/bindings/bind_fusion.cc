#include <optional>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "depth_normals.h"
#include "fusion.h"

namespace py = pybind11;

namespace sirpy {
namespace {

// A DepthView that keeps its array alive.
struct OwnedDepthView {
  DepthView view;
  Array<float> depth;
  std::optional<Array<float>> sigma;
};

OwnedDepthView MakeDepthView(const Eigen::Matrix3d& intrinsics, const Pose& cam_from_world,
                             int64_t x0, int64_t y0, int rank, Array<float> depth,
                             std::optional<Array<float>> sigma) {
  CheckDimensions(depth, 2, "depth");
  OwnedDepthView owned;
  owned.view.intrinsics = intrinsics;
  owned.view.rotation = cam_from_world.leftCols<3>();
  owned.view.translation = cam_from_world.col(3);
  owned.view.rectangle = {x0, y0, depth.shape(1), depth.shape(0)};
  owned.view.rank = rank;
  owned.view.depth = depth.data();
  if (sigma) {
    CheckMap(*sigma, depth.shape(0), depth.shape(1), "sigma", "depth");
    owned.view.sigma = sigma->data();
  }
  owned.depth = std::move(depth);
  owned.sigma = std::move(sigma);
  return owned;
}

// Points as bytes, and how many pixels gave none for which reason.
py::tuple RunFuse(const OwnedDepthView& reference, const Array<float>& normal,
                  const Array<uint8_t>& color, const std::optional<Array<float>>& confidence,
                  const std::optional<Array<uint8_t>>& level,
                  const std::vector<std::optional<OwnedDepthView>>& sources, int block_side,
                  const Array<uint32_t>& allowed, const FusionOptions& options) {
  const auto height = reference.depth.shape(0), width = reference.depth.shape(1);
  CheckPlanes(normal, height, width, "normal", "the reference's depth");
  CheckDimensions(color, 3, "color");
  if (color.shape(0) != height || color.shape(1) != width || color.shape(2) != 3) {
    throw py::value_error("color must have 3 channels of the size of the reference's depth");
  }
  if (level) CheckMap(*level, height, width, "level", "the reference's depth");
  if (confidence) CheckMap(*confidence, height, width, "confidence", "the reference's depth");
  CheckDimensions(allowed, 2, "allowed");
  const SourceBlocks blocks{block_side, int(allowed.shape(1)), int(allowed.shape(0)),
                            allowed.data()};
  const ReferenceMaps maps{normal.data(), color.data(), confidence ? confidence->data() : nullptr,
                           level ? level->data() : nullptr};
  std::vector<DepthView> views;
  for (const auto& source : sources) views.push_back(source ? source->view : DepthView{});
  FusedPoints fused;
  {
    py::gil_scoped_release release;
    fused = Fuse(reference.view, maps, views, blocks, options);
  }
  const auto bytes = py::ssize_t(fused.points.size() * sizeof(FusedPoint));
  auto owned = std::make_unique<std::vector<FusedPoint>>(std::move(fused.points));
  const auto* data = reinterpret_cast<const uint8_t*>(owned->data());
  py::capsule owner(owned.release(),
                    [](void* p) { delete static_cast<std::vector<FusedPoint>*>(p); });
  return py::make_tuple(py::array_t<uint8_t>({bytes}, data, owner),
                        py::make_tuple(fused.num_invalid, fused.num_inconsistent,
                                       fused.num_seen_through, fused.num_yielded));
}

Array<float> RunNormalsOfDepth(const Array<float>& depth, const Eigen::Matrix3d& intrinsics,
                               int64_t x0, int64_t y0, int threads) {
  CheckDimensions(depth, 2, "depth");
  const Rectangle window{x0, y0, depth.shape(1) - 2 * kNormalReach,
                         depth.shape(0) - 2 * kNormalReach};
  if (window.width < 1 || window.height < 1) {
    throw py::value_error("depth must have " + std::to_string(kNormalReach) +
                          " pixels around the window");
  }
  std::vector<float> normals;
  {
    py::gil_scoped_release release;
    normals = NormalsOfDepth(depth.data(), window, intrinsics, threads);
  }
  return ToArray(std::move(normals), {3, window.height, window.width});
}

}  // namespace

void BindFusion(py::module_& module) {
  py::class_<FusionOptions>(module, "FusionOptions")
      .def(py::init<>())
      .def_readwrite("min_consistent", &FusionOptions::min_consistent)
      .def_readwrite("consistency", &FusionOptions::consistency)
      .def_readwrite("yield_shift", &FusionOptions::yield_shift)
      .def_readwrite("yield_footprint", &FusionOptions::yield_footprint)
      .def_readwrite("see_through", &FusionOptions::see_through)
      .def_readwrite("agreement", &FusionOptions::agreement)
      .def_readwrite("thin", &FusionOptions::thin)
      .def_readwrite("keep_duplicates", &FusionOptions::keep_duplicates)
      .def_readwrite("threads", &FusionOptions::threads)
      .def("validate", &FusionOptions::Validate);

  py::class_<OwnedDepthView>(module, "DepthView")
      .def(py::init(&MakeDepthView), py::kw_only(), py::arg("intrinsics"),
           py::arg("cam_from_world"), py::arg("x0"), py::arg("y0"), py::arg("rank"),
           py::arg("depth").noconvert(), py::arg("sigma").noconvert() = py::none());

  module.def("fuse", &RunFuse, py::arg("reference"), py::arg("normal").noconvert(),
             py::arg("color").noconvert(), py::arg("confidence").noconvert(),
             py::arg("level").noconvert(), py::arg("sources"), py::kw_only(), py::arg("block_side"),
             py::arg("allowed").noconvert(), py::arg("options"));
  module.attr("NORMAL_REACH") = kNormalReach;
  module.def("normals_of_depth", &RunNormalsOfDepth, py::arg("depth").noconvert(), py::kw_only(),
             py::arg("intrinsics"), py::arg("x0"), py::arg("y0"), py::arg("threads") = 0);
}

}  // namespace sirpy
