#include <optional>

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/bindings.h"
#include "synthetic/nearest.h"
#include "synthetic/render.h"
#include "synthetic/scene.h"
#include "synthetic/surface.h"

namespace py = pybind11;

namespace sirpy {
namespace {

using IndexRows = Eigen::Matrix<int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
using ConstPoints = Eigen::Ref<const PointRows>;
using ConstPlaces = Eigen::Ref<const Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>>;

PointRows RowsOf(const std::vector<Eigen::Vector3d>& points) {
  PointRows rows(points.size(), 3);
  for (size_t i = 0; i < points.size(); ++i) rows.row(i) = points[i];
  return rows;
}

Surface MakeSurface(const ConstPoints& vertices, const Eigen::Ref<const IndexRows>& triangles) {
  std::vector<Eigen::Vector3d> corners(vertices.rows());
  for (Eigen::Index i = 0; i < vertices.rows(); ++i) corners[i] = vertices.row(i);
  std::vector<Surface::Triangle> faces(triangles.rows());
  for (Eigen::Index i = 0; i < triangles.rows(); ++i) faces[i] = triangles.row(i);
  return Surface(std::move(corners), std::move(faces));
}

Eigen::VectorXd Cast(const Surface& surface, const Eigen::Vector3d& origin,
                     const ConstPoints& directions) {
  Eigen::VectorXd t(directions.rows());
#pragma omp parallel for schedule(dynamic, 1024)
  for (Eigen::Index i = 0; i < directions.rows(); ++i) {
    t[i] = surface.Cast(origin, directions.row(i).transpose()).t;
  }
  return t;
}

Eigen::Array<bool, Eigen::Dynamic, 1> Sees(const Surface& surface, const Eigen::Vector3d& viewpoint,
                                           const ConstPoints& points, double tolerance) {
  Eigen::Array<bool, Eigen::Dynamic, 1> seen(points.rows());
#pragma omp parallel for schedule(dynamic, 1024)
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    seen[i] = surface.Sees(viewpoint, points.row(i).transpose(), tolerance);
  }
  return seen;
}

Eigen::VectorXd Distances(const Surface& surface, const ConstPoints& points, double limit) {
  Eigen::VectorXd distances(points.rows());
#pragma omp parallel for schedule(dynamic, 1024)
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    distances[i] = surface.Distance(points.row(i).transpose(), limit);
  }
  return distances;
}

Array<uint8_t> RenderBand(const Scene& scene, const Array<double>& nodes, int64_t first_row,
                          const Eigen::Vector3d& centre, const Eigen::Matrix3d& world_from_cam,
                          const RenderOptions& options) {
  CheckDimensions(nodes, 3, "nodes");
  if (nodes.shape(0) < 2 || nodes.shape(1) < 2 || nodes.shape(2) != 2) {
    throw py::value_error("nodes must have the shape (rows + 1, columns + 1, 2)");
  }
  const RayBand band{nodes.data(), nodes.shape(0) - 1, nodes.shape(1) - 1, first_row,
                     centre,       world_from_cam};
  std::vector<uint8_t> rgb;
  {
    py::gil_scoped_release release;
    rgb = Render(scene, band, options);
  }
  Array<uint8_t> image({band.rows, band.columns, int64_t{3}});
  std::copy(rgb.begin(), rgb.end(), image.mutable_data());
  return image;
}

Eigen::VectorXd TerrainHeights(uint64_t seed, const ConstPlaces& places) {
  Eigen::VectorXd heights(places.rows());
  for (Eigen::Index i = 0; i < places.rows(); ++i) {
    heights[i] = TerrainHeight(seed, places(i, 0), places(i, 1));
  }
  return heights;
}

void BindSurface(py::module_& module) {
  using Release = py::call_guard<py::gil_scoped_release>;
  py::class_<Surface>(module, "Surface")
      .def(py::init(&MakeSurface), py::arg("vertices").noconvert(),
           py::arg("triangles").noconvert())
      .def_property_readonly("vertices", [](const Surface& s) { return RowsOf(s.vertices()); })
      .def_property_readonly("triangles",
                             [](const Surface& s) {
                               IndexRows rows(s.triangles().size(), 3);
                               for (size_t i = 0; i < s.triangles().size(); ++i) {
                                 rows.row(i) = s.triangles()[i];
                               }
                               return rows;
                             })
      .def("cast", &Cast, py::arg("origin"), py::arg("directions").noconvert(), Release())
      .def("sees", &Sees, py::arg("viewpoint"), py::arg("points").noconvert(), py::arg("tolerance"),
           Release())
      .def("distances", &Distances, py::arg("points").noconvert(), py::arg("limit"), Release())
      .def(
          "sample",
          [](const Surface& surface, double spacing, uint64_t seed, const Eigen::Vector2d& minimum,
             const Eigen::Vector2d& maximum) {
            const SurfaceSamples samples = surface.Sample(spacing, seed, minimum, maximum);
            return std::make_pair(RowsOf(samples.points), RowsOf(samples.normals));
          },
          py::arg("spacing"), py::arg("seed"), py::arg("minimum"), py::arg("maximum"), Release());
}

void BindScene(py::module_& module) {
  py::class_<SceneOptions>(module, "SceneOptions")
      .def(py::init<>())
      .def_readwrite("seed", &SceneOptions::seed)
      .def_readwrite("half_extent", &SceneOptions::half_extent)
      .def_readwrite("terrain_step", &SceneOptions::terrain_step)
      .def_readwrite("finest_detail", &SceneOptions::finest_detail)
      .def_readwrite("tall", &SceneOptions::tall);
  py::class_<RenderOptions>(module, "RenderOptions")
      .def(py::init<>())
      .def_readwrite("samples", &RenderOptions::samples)
      .def_readwrite("sun", &RenderOptions::sun)
      .def_readwrite("noise", &RenderOptions::noise)
      .def_readwrite("seed", &RenderOptions::seed)
      .def_readwrite("threads", &RenderOptions::threads);
  py::class_<Scene>(module, "Scene")
      .def(py::init(&MakeScene), py::arg("options"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly(
          "surface", [](const Scene& scene) -> const Surface& { return scene.surface; },
          py::return_value_policy::reference_internal)
      .def("render", &RenderBand, py::arg("nodes").noconvert(), py::arg("first_row"),
           py::arg("centre"), py::arg("world_from_cam"), py::arg("options"));
}

}  // namespace

void BindSynthetic(py::module_& module) {
  BindSurface(module);
  BindScene(module);
  module.def("terrain_heights", &TerrainHeights, py::arg("seed"), py::arg("places").noconvert());
  module.def(
      "nearest_distances",
      [](const ConstPoints& queries, const ConstPoints& points, double limit) {
        return NearestDistances(queries, points, limit);
      },
      py::arg("queries").noconvert(), py::arg("points").noconvert(), py::arg("limit"),
      py::call_guard<py::gil_scoped_release>());
}

}  // namespace sirpy
