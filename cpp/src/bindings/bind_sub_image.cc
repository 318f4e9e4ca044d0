#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "sub_image/jpeg_reader.h"
#include "sub_image/lens_map.h"
#include "sub_image/png_reader.h"
#include "sub_image/read_window.h"
#include "sub_image/recapture.h"

namespace py = pybind11;

namespace sirpy {
namespace {

namespace fs = std::filesystem;
using Shape = std::tuple<int64_t, int64_t, int>;                        // width, height, channels
using Size = std::tuple<int64_t, int64_t>;                              // width, height
using File = std::tuple<fs::path, int64_t, int64_t, int64_t, int64_t>;  // path, x0, y0, w, h

RecaptureTask MakeTask(const Shape& photograph, const std::shared_ptr<LensMap>& lens,
                       const Size& size, const std::vector<File>& files, int jpeg_quality) {
  RecaptureTask task;
  std::tie(task.photograph.width, task.photograph.height, task.photograph.channels) = photograph;
  task.lens = lens;
  std::tie(task.width, task.height) = size;
  for (const auto& [path, x0, y0, width, height] : files) {
    task.sub_images.push_back({path, {x0, y0, width, height}});
  }
  task.writer.jpeg_quality = jpeg_quality;
  return task;
}

std::shared_ptr<LensMap> MakeLensMap(const Array<double>& nodes, const Size& size) {
  CheckDimensions(nodes, 3, "nodes");
  if (nodes.shape(2) != 2) throw py::value_error("nodes must be rows x columns x 2");
  return std::make_shared<LensMap>(std::vector<double>(nodes.data(), nodes.data() + nodes.size()),
                                   nodes.shape(0), nodes.shape(1), std::get<0>(size),
                                   std::get<1>(size));
}

Array<double> LensMapAt(const LensMap& lens, const Array<double>& points) {
  CheckDimensions(points, 2, "points");
  if (points.shape(1) != 2) throw py::value_error("points must be n x 2");
  Array<double> out({points.shape(0), py::ssize_t{2}});
  for (py::ssize_t i = 0; i < points.shape(0); ++i) {
    const Eigen::Vector2d position = lens.At({points.at(i, 0), points.at(i, 1)});
    out.mutable_at(i, 0) = position.x();
    out.mutable_at(i, 1) = position.y();
  }
  return out;
}

void PushRows(Recapture& recapture, const Array<uint8_t>& rows) {
  CheckDimensions(rows, 3, "rows");
  const ImageShape& shape = recapture.photograph();
  if (rows.shape(1) != shape.width || rows.shape(2) != shape.channels) {
    throw py::value_error("rows must be n x width x channels of the photograph");
  }
  py::gil_scoped_release release;
  recapture.Push(rows.data(), rows.shape(0));
}

Array<uint8_t> ReadWindow(const fs::path& path, int64_t x0, int64_t y0, int64_t width,
                          int64_t height, bool color) {
  const Rectangle window{x0, y0, width, height};
  std::vector<uint8_t> pixels;
  {
    py::gil_scoped_release release;
    pixels = color ? ReadColor(path, window) : ReadGrey(path, window);
  }
  std::vector<py::ssize_t> shape{height, width};
  if (color) shape.push_back(3);
  return Array<uint8_t>(shape, pixels.data());
}

void DefRecaptureFile(py::module_& module, const char* name,
                      void (*recapture)(const fs::path&, RecaptureTask)) {
  module.def(
      name,
      [recapture](const fs::path& path, const Shape& photograph,
                  const std::shared_ptr<LensMap>& lens, const Size& size,
                  const std::vector<File>& files, int jpeg_quality) {
        RecaptureTask task = MakeTask(photograph, lens, size, files, jpeg_quality);
        py::gil_scoped_release release;
        recapture(path, std::move(task));
      },
      py::arg("path"), py::arg("photograph"), py::arg("lens"), py::arg("size"), py::arg("files"),
      py::arg("jpeg_quality"));
}

}  // namespace

void BindSubImage(py::module_& module) {
  module.def(
      "jpeg_shape",
      [](const fs::path& path) {
        const ImageShape shape = JpegReader(path).shape();
        return Shape{shape.width, shape.height, shape.channels};
      },
      py::arg("path"));
  module.def(
      "png_shape",
      [](const fs::path& path) {
        const PngReader reader(path);
        const ImageShape& shape = reader.shape();
        return std::make_tuple(shape.width, shape.height, shape.channels, reader.has_alpha());
      },
      py::arg("path"));

  py::class_<LensMap, std::shared_ptr<LensMap>>(module, "LensMap")
      .def(py::init(&MakeLensMap), py::arg("nodes").noconvert(), py::arg("size"))
      .def("at", &LensMapAt, py::arg("points").noconvert());

  py::class_<Recapture>(module, "Recapture")
      .def(py::init([](const Shape& photograph, const std::shared_ptr<LensMap>& lens,
                       const Size& size, const std::vector<File>& files, int jpeg_quality) {
             return std::make_unique<Recapture>(
                 MakeTask(photograph, lens, size, files, jpeg_quality));
           }),
           py::arg("photograph"), py::arg("lens"), py::arg("size"), py::arg("files"),
           py::arg("jpeg_quality"))
      .def("push", &PushRows, py::arg("rows").noconvert())
      .def("finish", &Recapture::Finish, py::call_guard<py::gil_scoped_release>());

  DefRecaptureFile(module, "recapture_jpeg", &RecaptureJpeg);
  DefRecaptureFile(module, "recapture_png", &RecapturePng);

  module.def("read_window", &ReadWindow, py::arg("path"), py::arg("x0"), py::arg("y0"),
             py::arg("width"), py::arg("height"), py::arg("color"));
}

}  // namespace sirpy
