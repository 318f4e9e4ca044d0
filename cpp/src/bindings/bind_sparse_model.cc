#include <array>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "sub_image/model_reader.h"
#include "sub_image/model_writer.h"
#include "sub_image/sparse_model.h"
#include "sub_image/sub_image_model.h"

namespace py = pybind11;

namespace sirpy {
namespace {

namespace fs = std::filesystem;
// id, number of the camera model, width, height, parameters
using Camera = std::tuple<uint32_t, int32_t, int64_t, int64_t, std::vector<double>>;
// id, camera id, name, pose
using Image = std::tuple<uint32_t, uint32_t, std::string, std::array<double, 7>>;
// The fields of SparseModel in their order.
using Model =
    std::tuple<std::vector<Camera>, std::vector<Image>, Array<uint64_t>, Array<double>,
               Array<uint8_t>, Array<double>, Array<int64_t>, Array<double>, Array<int32_t>>;
// name, index of the native image, x0, y0, width, height
using SubImage = std::tuple<std::string, size_t, int64_t, int64_t, int64_t, int64_t>;

template <typename T>
std::vector<T> ToVector(const Array<T>& array) {
  return {array.data(), array.data() + array.size()};
}

SparseModel ToModel(const Model& given) {
  const auto& [cameras, images, ids, xyz, rgb, errors, starts, xy, point] = given;
  SparseModel model;
  for (const auto& [id, number, width, height, parameters] : cameras) {
    model.cameras.push_back({id, number, width, height, parameters});
  }
  for (const auto& [id, camera_id, name, pose] : images) {
    model.images.push_back({id, camera_id, name, pose});
  }
  model.point_ids = ToVector(ids);
  model.xyz = ToVector(xyz);
  model.rgb = ToVector(rgb);
  model.errors = ToVector(errors);
  model.starts = ToVector(starts);
  model.xy = ToVector(xy);
  model.point = ToVector(point);
  return model;
}

Model FromModel(SparseModel&& model) {
  std::vector<Camera> cameras;
  for (ModelCamera& c : model.cameras) {
    cameras.emplace_back(c.id, c.model, c.width, c.height, std::move(c.parameters));
  }
  std::vector<Image> images;
  for (ModelImage& i : model.images) {
    images.emplace_back(i.id, i.camera_id, std::move(i.name), i.pose);
  }
  const auto points = static_cast<py::ssize_t>(model.point_ids.size());
  const auto starts = static_cast<py::ssize_t>(model.starts.size());
  const auto seen = static_cast<py::ssize_t>(model.point.size());
  return {std::move(cameras),
          std::move(images),
          ToArray(std::move(model.point_ids), {points}),
          ToArray(std::move(model.xyz), {points, 3}),
          ToArray(std::move(model.rgb), {points, 3}),
          ToArray(std::move(model.errors), {points}),
          ToArray(std::move(model.starts), {starts}),
          ToArray(std::move(model.xy), {seen, 2}),
          ToArray(std::move(model.point), {seen})};
}

}  // namespace

void BindSparseModel(py::module_& module) {
  module.def("num_camera_parameters", &NumCameraParameters, py::arg("model"));
  module.def(
      "read_model",
      [](const fs::path& folder) {
        SparseModel model;
        {
          py::gil_scoped_release release;
          model = ReadModel(folder);
        }
        return FromModel(std::move(model));
      },
      py::arg("folder"));
  module.def(
      "write_model",
      [](const Model& given, const fs::path& folder) {
        const SparseModel model = ToModel(given);
        py::gil_scoped_release release;
        WriteModel(model, folder);
      },
      py::arg("model").noconvert(), py::arg("folder"));
  module.def(
      "sub_image_model",
      [](const Model& given, const std::vector<SubImage>& given_sub_images) {
        std::vector<RecapturedImage> sub_images;
        for (const auto& [name, native, x0, y0, width, height] : given_sub_images) {
          sub_images.push_back({name, native, {x0, y0, width, height}});
        }
        SparseModel made;
        {
          const SparseModel native = ToModel(given);
          py::gil_scoped_release release;
          made = SubImageModel(native, sub_images);
        }
        return FromModel(std::move(made));
      },
      py::arg("native").noconvert(), py::arg("sub_images"));
}

}  // namespace sirpy
