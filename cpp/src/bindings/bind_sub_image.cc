#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "sub_image/image_reader.h"
#include "sub_image/lens_map.h"
#include "sub_image/read_window.h"
#include "sub_image/recapture.h"

namespace py = pybind11;

namespace sirpy {
namespace {

namespace fs = std::filesystem;
using Shape = std::tuple<int64_t, int64_t, int, int>;  // width, height, channels, bytes of a sample
using Size = std::tuple<int64_t, int64_t>;             // width, height
using File = std::tuple<fs::path, int64_t, int64_t, int64_t, int64_t>;  // path, x0, y0, w, h

ImageShape ToImageShape(const Shape& shape) {
  const auto& [width, height, channels, sample_bytes] = shape;
  return {width, height, channels, sample_bytes};
}

Shape FromImageShape(const ImageShape& shape) {
  return {shape.width, shape.height, shape.channels, shape.sample_bytes};
}

// One of the words of `choices`, each at the place of its value.
template <typename Value>
Value Choice(const std::string& word, const std::vector<std::string>& choices) {
  for (size_t i = 0; i < choices.size(); ++i) {
    if (choices[i] == word) return static_cast<Value>(i);
  }
  throw py::value_error(word + " is not one of the choices");
}

Bands ToBands(const std::string& word) { return Choice<Bands>(word, {"color", "all"}); }

Pixels ToPixels(const std::string& word) { return Choice<Pixels>(word, {"grey", "color", "all"}); }

RecaptureTask MakeTask(const Shape& photograph, const std::shared_ptr<LensMap>& lens,
                       const std::string& interpolation, const Size& size,
                       const std::vector<File>& files, int jpeg_quality,
                       const std::string& jpeg_chroma, bool last_is_alpha, bool in_memory,
                       int white) {
  RecaptureTask task;
  task.photograph = ToImageShape(photograph);
  task.lens = lens;
  task.interpolation =
      Choice<Interpolation>(interpolation, {"nearest", "bilinear", "bicubic", "lanczos"});
  std::tie(task.width, task.height) = size;
  for (const auto& [path, x0, y0, width, height] : files) {
    task.sub_images.push_back({path, {x0, y0, width, height}});
  }
  task.writer.jpeg_quality = jpeg_quality;
  task.writer.jpeg_chroma = Choice<JpegChroma>(jpeg_chroma, {"444", "422", "420"});
  task.writer.last_is_alpha = last_is_alpha;
  task.in_memory = in_memory;
  task.white = white;
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

// Pixels as numpy has them: height x width x channels of uint8 or uint16 in native byte order,
// contiguous and aligned.
ImageShape ShapeOf(const py::array& pixels) {
  constexpr int kWanted = py::array::c_style | py::detail::npy_api::NPY_ARRAY_ALIGNED_;
  const bool bytes = pixels.dtype().equal(py::dtype::of<uint8_t>());
  if (pixels.ndim() != 3 || pixels.shape(2) < 1 || (pixels.flags() & kWanted) != kWanted ||
      !(bytes || pixels.dtype().equal(py::dtype::of<uint16_t>()))) {
    throw py::value_error(
        "pixels must be height x width x channels of uint8 or uint16, contiguous and aligned");
  }
  return {pixels.shape(1), pixels.shape(0), static_cast<int>(pixels.shape(2)), bytes ? 1 : 2};
}

const uint8_t* DataOf(const py::array& pixels) {
  return static_cast<const uint8_t*>(pixels.data());
}

// height x width x channels, or height x width where `flat`; takes the bytes without a copy.
py::array ImageArray(const ImageShape& shape, std::vector<uint8_t>&& bytes, bool flat) {
  std::vector<py::ssize_t> sides{shape.height, shape.width};
  if (!flat) sides.push_back(shape.channels);
  auto owned = std::make_unique<std::vector<uint8_t>>(std::move(bytes));
  const void* data = owned->data();
  py::capsule owner(owned.release(), [](void* p) { delete static_cast<std::vector<uint8_t>*>(p); });
  const py::dtype type =
      shape.sample_bytes == 1 ? py::dtype::of<uint8_t>() : py::dtype::of<uint16_t>();
  return py::array(type, sides, data, owner);
}

py::array BindReadWindow(const fs::path& path, int64_t x0, int64_t y0, int64_t width,
                         int64_t height, const std::string& pixels, int white) {
  const Pixels kind = ToPixels(pixels);
  const Rectangle window{x0, y0, width, height};
  if (width < 1 || height < 1) throw py::value_error("a window has at least one pixel");
  WindowPixels read;
  {
    py::gil_scoped_release release;
    read = ReadWindow(path, window, kind, white);
  }
  return ImageArray(read.shape, std::move(read.bytes), kind == Pixels::kGrey);
}

py::array BindConvertPixels(const py::array& stored, const std::string& pixels, int white) {
  const Pixels kind = ToPixels(pixels);
  const ImageShape shape = ShapeOf(stored);
  const uint8_t* data = DataOf(stored);
  const ImageShape converted = ConvertedShape(shape, {0, 0, shape.width, shape.height}, kind);
  std::vector<uint8_t> bytes(converted.RowBytes() * converted.height);
  {
    py::gil_scoped_release release;
    ConvertPixels(data, shape, shape.width * shape.height, kind, white, bytes.data());
  }
  return ImageArray(converted, std::move(bytes), kind == Pixels::kGrey);
}

}  // namespace

void BindSubImage(py::module_& module) {
  module.def(
      "image_header",
      [](const fs::path& path, const std::string& bands) {
        const auto reader = OpenImageReader(path, ToBands(bands));
        return std::make_tuple(FromImageShape(reader->shape()), reader->has_alpha(),
                               reader->held_bytes_per_pixel());
      },
      py::arg("path"), py::arg("bands"));

  module.def(
      "count_samples",
      [](const fs::path& path) {
        std::vector<int64_t> count;
        {
          py::gil_scoped_release release;
          count = CountSamples(*OpenImageReader(path, Bands::kColor));
        }
        const auto size = static_cast<py::ssize_t>(count.size());
        return ToArray(std::move(count), {size});
      },
      py::arg("path"));

  py::class_<LensMap, std::shared_ptr<LensMap>>(module, "LensMap")
      .def(py::init(&MakeLensMap), py::arg("nodes").noconvert(), py::arg("size"))
      .def("at", &LensMapAt, py::arg("points").noconvert());

  py::class_<Recapture>(module, "Recapture")
      .def(py::init([](const Shape& photograph, const std::shared_ptr<LensMap>& lens,
                       const std::string& interpolation, const Size& size,
                       const std::vector<File>& files, int jpeg_quality,
                       const std::string& jpeg_chroma, bool last_is_alpha, bool in_memory,
                       int white) {
             return std::make_unique<Recapture>(MakeTask(photograph, lens, interpolation, size,
                                                         files, jpeg_quality, jpeg_chroma,
                                                         last_is_alpha, in_memory, white));
           }),
           py::kw_only(), py::arg("photograph"), py::arg("lens"), py::arg("interpolation"),
           py::arg("size"), py::arg("files"), py::arg("jpeg_quality"), py::arg("jpeg_chroma"),
           py::arg("last_is_alpha"), py::arg("in_memory"), py::arg("white"))
      .def_property_readonly("first_row", &Recapture::first_row)
      .def_property_readonly("done", &Recapture::Done)
      .def(
          "push",
          [](Recapture& self, const py::array& rows) {
            ImageShape expected = self.photograph();
            expected.height = rows.ndim() > 0 ? rows.shape(0) : 0;
            if (!(ShapeOf(rows) == expected)) {
              throw py::value_error(
                  "rows have another width, or other samples, than the photograph");
            }
            const uint8_t* data = DataOf(rows);
            py::gil_scoped_release release;
            self.Push(data, expected.height);
          },
          py::arg("rows").noconvert())
      .def("finish", &Recapture::Finish, py::call_guard<py::gil_scoped_release>())
      .def(
          "read",
          [](Recapture& self, const fs::path& path, const std::string& bands) {
            const Bands kind = ToBands(bands);
            py::gil_scoped_release release;
            RecaptureFrom(*OpenImageReader(path, kind), self);
          },
          py::arg("path"), py::arg("bands"))
      .def("take_pixels",
           [](Recapture& self) { return ImageArray(self.kept_shape(), self.TakePixels(), false); });

  module.def("read_window", &BindReadWindow, py::arg("path"), py::arg("x0"), py::arg("y0"),
             py::arg("width"), py::arg("height"), py::arg("pixels"), py::arg("white"));
  module.def("convert_pixels", &BindConvertPixels, py::arg("stored").noconvert(), py::arg("pixels"),
             py::arg("white"));
}

}  // namespace sirpy
