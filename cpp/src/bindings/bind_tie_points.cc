#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "sub_image/image_reader.h"
#include "tie_points/least_squares_matching.h"
#include "tie_points/patch_cutter.h"

namespace py = pybind11;

namespace sirpy {
namespace {

using Shape = std::tuple<int64_t, int64_t, int, int>;  // width, height, channels, bytes of a sample

std::unique_ptr<PatchCutter> MakeCutter(const Shape& shape, const Array<int64_t>& origins,
                                        int side) {
  CheckDimensions(origins, 2, "origins");
  if (origins.shape(1) != 2) throw py::value_error("origins must be n x 2");
  std::vector<std::array<int64_t, 2>> corners(origins.shape(0));
  for (size_t i = 0; i < corners.size(); ++i) {
    corners[i] = {origins.at(i, 0), origins.at(i, 1)};
  }
  const auto& [width, height, channels, sample_bytes] = shape;
  return std::make_unique<PatchCutter>(ImageShape{width, height, channels, sample_bytes},
                                       std::move(corners), side);
}

void PushRows(PatchCutter& cutter, const py::array& rows) {
  const ImageShape& shape = cutter.photograph();
  if (rows.ndim() != 3 || rows.shape(1) != shape.width || rows.shape(2) != shape.channels ||
      rows.itemsize() != shape.sample_bytes || !(rows.flags() & py::array::c_style)) {
    throw py::value_error("rows must be n x width x channels, contiguous, as the photograph is");
  }
  cutter.Push(static_cast<const uint8_t*>(rows.data()), rows.shape(0));
}

py::array_t<uint16_t> TakePatches(PatchCutter& cutter, int side) {
  std::vector<uint16_t> patches = cutter.TakePatches();
  const py::ssize_t count = static_cast<py::ssize_t>(patches.size()) / side / side;
  return ToArray(std::move(patches), {count, side, side});
}

// n square patches.
void CheckPatches(const Array<uint16_t>& patches, const char* name) {
  CheckDimensions(patches, 3, name);
  if (patches.shape(1) != patches.shape(2)) {
    throw py::value_error(std::string(name) + " must be squares");
  }
}

LumaPatch PatchAt(const Array<uint16_t>& patches, py::ssize_t i) {
  return {patches.data(i, 0, 0), static_cast<int>(patches.shape(1))};
}

void CheckRows(py::ssize_t found, py::ssize_t expected, const char* name) {
  if (found != expected) throw py::value_error(std::string(name) + " must have a row for each");
}

Array<int32_t> BestTexturedOfAll(const Array<uint16_t>& patches, const Array<int32_t>& starts,
                                 int radius, int window_radius, int threads) {
  CheckPatches(patches, "patches");
  CheckDimensions(starts, 2, "starts");
  CheckRows(starts.shape(0), patches.shape(0), "starts");
  Array<int32_t> best({patches.shape(0), py::ssize_t{2}});
  int32_t* out = best.mutable_data();
  const py::ssize_t count = patches.shape(0);
  const py::gil_scoped_release unlocked;
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads)
  for (py::ssize_t i = 0; i < count; ++i) {
    const int32_t* start = starts.data(i, 0);
    const Eigen::Vector2i found =
        BestTextured(PatchAt(patches, i), {start[0], start[1]}, radius, window_radius);
    out[2 * i] = found.x();
    out[2 * i + 1] = found.y();
  }
  return best;
}

// (status, position, affine, covariance, correlation), one row for each target.
py::tuple MatchAll(const Array<uint16_t>& references, const Array<int32_t>& centres,
                   const Array<uint16_t>& targets, const Array<double>& positions,
                   const Array<double>& affines, const Array<int32_t>& whites, int threads,
                   const MatchingOptions& options) {
  CheckPatches(references, "references");
  CheckPatches(targets, "targets");
  const py::ssize_t count = targets.shape(0);
  CheckRows(references.shape(0), count, "references");
  CheckDimensions(centres, 2, "centres");
  CheckRows(centres.shape(0), count, "centres");
  CheckDimensions(positions, 2, "positions");
  CheckRows(positions.shape(0), count, "positions");
  CheckDimensions(affines, 3, "affines");
  CheckRows(affines.shape(0), count, "affines");
  CheckDimensions(whites, 2, "whites");
  CheckRows(whites.shape(0), count, "whites");
  Array<uint8_t> status(std::vector<py::ssize_t>{count});
  Array<double> found(std::vector<py::ssize_t>{count, 2});
  Array<double> shapes(std::vector<py::ssize_t>{count, 2, 2});
  Array<double> covariances(std::vector<py::ssize_t>{count, 2, 2});
  Array<double> correlations(std::vector<py::ssize_t>{count});
  uint8_t* status_out = status.mutable_data();
  double* found_out = found.mutable_data();
  double* shapes_out = shapes.mutable_data();
  double* covariances_out = covariances.mutable_data();
  double* correlations_out = correlations.mutable_data();
  {
    const py::gil_scoped_release unlocked;
    using RowMajor = Eigen::Matrix<double, 2, 2, Eigen::RowMajor>;
#pragma omp parallel for schedule(dynamic, 16) num_threads(threads)
    for (py::ssize_t i = 0; i < count; ++i) {
      PatchMap predicted;
      predicted.position = Eigen::Map<const Eigen::Vector2d>(positions.data(i, 0));
      predicted.affine = Eigen::Map<const RowMajor>(affines.data(i, 0, 0));
      LumaPatch reference = PatchAt(references, i), target = PatchAt(targets, i);
      reference.white = *whites.data(i, 0);
      target.white = *whites.data(i, 1);
      const PatchMatch match = MatchPatch(reference, {*centres.data(i, 0), *centres.data(i, 1)},
                                          target, predicted, options);
      status_out[i] = static_cast<uint8_t>(match.status);
      Eigen::Map<Eigen::Vector2d>(found_out + 2 * i) = match.map.position;
      Eigen::Map<RowMajor>(shapes_out + 4 * i) = match.map.affine;
      Eigen::Map<RowMajor>(covariances_out + 4 * i) = match.covariance;
      correlations_out[i] = match.correlation;
    }
  }
  return py::make_tuple(status, found, shapes, covariances, correlations);
}

}  // namespace

void BindTiePoints(py::module_& module) {
  py::class_<PatchCutter>(module, "PatchCutter")
      .def(py::init(&MakeCutter), py::arg("photograph"), py::arg("origins").noconvert(),
           py::arg("side"))
      .def_property_readonly("first_row", &PatchCutter::first_row)
      .def_property_readonly("done", &PatchCutter::Done)
      .def("push", &PushRows, py::arg("rows"))
      .def(
          "read",
          [](PatchCutter& cutter, const std::filesystem::path& path) {
            const std::unique_ptr<ImageReader> photograph = OpenImageReader(path, Bands::kColor);
            CutPatches(*photograph, cutter);
          },
          py::arg("path"), py::call_guard<py::gil_scoped_release>())
      .def("take", &TakePatches, py::arg("side"));

  py::class_<MatchingOptions>(module, "MatchingOptions")
      .def(py::init([](int radius, int search_radius, double grey_level) {
             MatchingOptions options;
             options.radius = radius;
             options.search_radius = search_radius;
             options.grey_level = grey_level;
             return options;
           }),
           py::arg("radius"), py::arg("search_radius"), py::arg("grey_level"))
      .def_readwrite("min_correlation", &MatchingOptions::min_correlation)
      .def_readwrite("max_rival", &MatchingOptions::max_rival)
      .def_readwrite("max_deviation", &MatchingOptions::max_deviation)
      .def_readwrite("max_distortion", &MatchingOptions::max_distortion)
      .def_readwrite("max_saturated", &MatchingOptions::max_saturated);
  module.def("best_textured", &BestTexturedOfAll, py::arg("patches").noconvert(),
             py::arg("starts").noconvert(), py::arg("radius"), py::arg("window_radius"),
             py::arg("threads"));
  module.def("match_patches", &MatchAll, py::arg("references").noconvert(),
             py::arg("centres").noconvert(), py::arg("targets").noconvert(),
             py::arg("positions").noconvert(), py::arg("affines").noconvert(),
             py::arg("whites").noconvert(), py::arg("threads"), py::arg("options"));
}

}  // namespace sirpy
