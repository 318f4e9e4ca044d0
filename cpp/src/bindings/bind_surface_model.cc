#include <algorithm>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "surface_model.h"

namespace py = pybind11;

namespace sirpy {
namespace {

py::array_t<float> RunSurfaceHeights(const Array<CloudPoint>& points, int64_t column, int64_t row,
                                     int64_t width, int64_t height, const SurfaceOptions& options) {
  CheckDimensions(points, 1, "points");
  if (width < 1 || height < 1) throw py::value_error("a window has at least one cell");
  std::vector<float> heights;
  {
    py::gil_scoped_release release;
    heights = SurfaceHeights(points.data(), points.shape(0), {column, row, width, height}, options);
  }
  return ToArray(std::move(heights), {height, width});
}

py::array_t<float> RunFillGaps(const Array<float>& heights, const GapOptions& options) {
  CheckDimensions(heights, 2, "heights");
  const py::ssize_t margin = options.Margin();
  const py::ssize_t height = heights.shape(0), width = heights.shape(1);
  if (!(options.longest > 0) || std::min(height, width) <= 2 * margin) {
    throw py::value_error("the heights must be those of a window and its margin");
  }
  std::vector<float> filled;
  {
    py::gil_scoped_release release;
    filled = FillGaps(heights.data(), width, height, options);
  }
  return ToArray(std::move(filled), {height - 2 * margin, width - 2 * margin});
}

}  // namespace

void BindSurfaceModel(py::module_& module) {
  PYBIND11_NUMPY_DTYPE(CloudPoint, x, y, z, nx, ny, nz, red, green, blue, views, confidence, gsd,
                       sigma, level);

  py::class_<SurfaceOptions>(module, "SurfaceOptions")
      .def(py::init<>())
      .def_readwrite("cell", &SurfaceOptions::cell)
      .def_readwrite("reach", &SurfaceOptions::reach)
      .def_readwrite("thickness", &SurfaceOptions::thickness)
      .def_readwrite("share", &SurfaceOptions::share)
      .def_readwrite("near", &SurfaceOptions::near)
      .def_readwrite("support", &SurfaceOptions::support)
      .def_property_readonly("margin", &SurfaceOptions::Margin)
      .def("validate", &SurfaceOptions::Validate);

  module.def("surface_heights", &RunSurfaceHeights, py::arg("points").noconvert(), py::kw_only(),
             py::arg("column"), py::arg("row"), py::arg("width"), py::arg("height"),
             py::arg("options"));
  py::class_<GapOptions>(module, "GapOptions")
      .def(py::init<>())
      .def_readwrite("longest", &GapOptions::longest)
      .def_readwrite("cell", &GapOptions::cell)
      .def_readwrite("step", &GapOptions::step)
      .def_property_readonly("margin", &GapOptions::Margin);

  module.def("fill_gaps", &RunFillGaps, py::arg("heights").noconvert(), py::kw_only(),
             py::arg("options"));
}

}  // namespace sirpy
