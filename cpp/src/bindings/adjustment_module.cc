// The extension sirpy._adjustment, apart from _core, which needs no Ceres.
#include <optional>

#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bundle_adjustment.h"

namespace py = pybind11;

namespace sirpy {
namespace {

template <int kColumns>
Rows<kColumns> ToRows(const Array<double>& array, const char* name) {
  CheckDimensions(array, 2, name);
  if (array.shape(1) != kColumns) {
    throw py::value_error(std::string(name) + " must have " + std::to_string(kColumns) +
                          " columns");
  }
  return Eigen::Map<const Rows<kColumns>>(array.data(), array.shape(0), kColumns);
}

template <int kColumns>
py::array_t<double> FromRows(const Rows<kColumns>& rows) {
  return ToArray(std::vector<double>(rows.data(), rows.data() + rows.size()),
                 {rows.rows(), kColumns});
}

std::vector<int32_t> ToIndices(const Array<int32_t>& array, const char* name) {
  CheckDimensions(array, 1, name);
  return {array.data(), array.data() + array.shape(0)};
}

// Lens, parameters, which are free, what they are expected to be, and how far from it.
using Camera = std::tuple<std::string, std::vector<double>, std::vector<bool>, std::vector<double>,
                          std::vector<double>>;

AdjustedModel MakeModel(const std::vector<Camera>& cameras, const Array<double>& frames,
                        const Array<double>& sensors, const Array<int32_t>& images,
                        const Array<double>& points) {
  AdjustedModel model;
  for (const auto& [lens, parameters, free, expected, sigma] : cameras) {
    model.cameras.push_back({lens, parameters, free, expected, sigma});
  }
  model.frames = ToRows<7>(frames, "frames");
  model.sensors = ToRows<7>(sensors, "sensors");
  model.points = ToRows<3>(points, "points");
  CheckDimensions(images, 2, "images");
  if (images.shape(1) != 3) throw py::value_error("images must have 3 columns");
  for (py::ssize_t i = 0; i < images.shape(0); ++i) {
    model.images.push_back({images.at(i, 0), images.at(i, 1), images.at(i, 2)});
  }
  return model;
}

Observations MakeObservations(const Array<int32_t>& image, const Array<int32_t>& point,
                              const Array<double>& xy, const Array<double>& whitening) {
  return {ToIndices(image, "image"), ToIndices(point, "point"), ToRows<2>(xy, "xy"),
          ToRows<4>(whitening, "whitening")};
}

Positions MakePositions(const Array<int32_t>& image, const Array<double>& centre,
                        const Array<double>& sigma) {
  return {ToIndices(image, "image"), ToRows<3>(centre, "centre"), ToRows<3>(sigma, "sigma")};
}

std::optional<std::vector<double>> DeviationsOf(const Adjustment& adjustment, size_t camera) {
  if (camera >= adjustment.deviations.size() || adjustment.deviations[camera].empty()) return {};
  return adjustment.deviations[camera];
}

py::tuple RunAdjust(const AdjustedModel& model, const Observations& observations,
                    const Positions& positions, double loss_scale, bool deviations) {
  AdjustmentOptions options;
  options.loss_scale = loss_scale;
  options.deviations = deviations;
  Adjustment adjustment;
  {
    const py::gil_scoped_release release;
    adjustment = Adjust(model, observations, positions, options);
  }
  py::list cameras;
  for (size_t i = 0; i < adjustment.model.cameras.size(); ++i) {
    cameras.append(
        py::make_tuple(adjustment.model.cameras[i].parameters, DeviationsOf(adjustment, i)));
  }
  return py::make_tuple(adjustment.usable, adjustment.message, cameras,
                        FromRows<7>(adjustment.model.frames), FromRows<7>(adjustment.model.sensors),
                        FromRows<3>(adjustment.model.points));
}

py::array_t<double> RunResiduals(const AdjustedModel& model, const Observations& observations) {
  Rows<2> residuals;
  {
    const py::gil_scoped_release release;
    residuals = Residuals(model, observations);
  }
  return FromRows<2>(residuals);
}

}  // namespace
}  // namespace sirpy

PYBIND11_MODULE(_adjustment, module) {
  using namespace sirpy;
  module.doc() = "Bundle adjustment by Ceres. Private: use sirpy.bundle_adjustment.";

  py::class_<AdjustedModel>(module, "Model")
      .def(py::init(&MakeModel), py::kw_only(), py::arg("cameras"), py::arg("frames").noconvert(),
           py::arg("sensors").noconvert(), py::arg("images").noconvert(),
           py::arg("points").noconvert());
  py::class_<Observations>(module, "Observations")
      .def(py::init(&MakeObservations), py::kw_only(), py::arg("image").noconvert(),
           py::arg("point").noconvert(), py::arg("xy").noconvert(),
           py::arg("whitening").noconvert());
  py::class_<Positions>(module, "Positions")
      .def(py::init(&MakePositions), py::kw_only(), py::arg("image").noconvert(),
           py::arg("centre").noconvert(), py::arg("sigma").noconvert());
  module.def("lens_names", &LensNames);
  module.def("adjust", &RunAdjust, py::arg("model"), py::arg("observations"), py::arg("positions"),
             py::kw_only(), py::arg("loss_scale"), py::arg("deviations"));
  module.def("residuals", &RunResiduals, py::arg("model"), py::arg("observations"));
}
