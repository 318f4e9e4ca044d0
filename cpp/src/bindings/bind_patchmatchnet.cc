#include <pybind11/eigen.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "patchmatchnet/group_correlation.h"

namespace py = pybind11;

namespace sirpy {
namespace {

FeatureMap MakeFeatureMap(const Array<float>& features, const char* name) {
  CheckDimensions(features, 3, name);
  return {features.data(), int(features.shape(0)), int(features.shape(1)), int(features.shape(2))};
}

py::array_t<float> RunGroupCorrelation(
    const Array<float>& reference, const Array<float>& source,
    const Eigen::Matrix<float, 3, 4, Eigen::RowMajor>& source_from_reference,
    const Array<float>& depth, int first_row, const Eigen::Vector2f& behind, int groups) {
  CheckDimensions(depth, 3, "depth");
  const FeatureMap map = MakeFeatureMap(reference, "reference");
  if (depth.shape(1) != map.height || depth.shape(2) != map.width) {
    throw py::value_error("depth must have the size of reference");
  }
  const ReferenceRows rows = {map, depth.data(), int(depth.shape(0)), first_row};
  const SourceFeatures features = {MakeFeatureMap(source, "source"), source_from_reference, behind};
  std::vector<float> found;
  {
    py::gil_scoped_release release;
    found = GroupCorrelation(rows, features, groups);
  }
  return ToArray(std::move(found), {groups, depth.shape(0), map.height, map.width});
}

}  // namespace

void BindPatchmatchnet(py::module_& module) {
  module.def("group_correlation", &RunGroupCorrelation, py::arg("reference").noconvert(),
             py::arg("source").noconvert(), py::arg("source_from_reference").noconvert(),
             py::arg("depth").noconvert(), py::kw_only(), py::arg("first_row"), py::arg("behind"),
             py::arg("groups"));
}

}  // namespace sirpy
