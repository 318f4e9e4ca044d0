// Checked views of numpy arrays: the type is exact (no silent conversion), C-contiguous, of the
// stated shape.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <Eigen/Core>

namespace sirpy {

template <typename T>
using Array = pybind11::array_t<T, pybind11::array::c_style>;

using Pose = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;  // cam_from_world

// Throws ValueError in Python when `array` has not `dimensions` dimensions. Bind arguments with
// py::arg("name").noconvert() so that a wrong dtype or a strided array is refused too.
template <typename T>
void CheckDimensions(const Array<T>& array, int dimensions, const char* name) {
  if (array.ndim() != dimensions) {
    throw pybind11::value_error(std::string(name) + " must have " + std::to_string(dimensions) +
                                " dimensions, not " + std::to_string(array.ndim()));
  }
}

// Throws ValueError in Python unless `array` is a map of that size; `of` has it too.
template <typename T>
void CheckMap(const Array<T>& array, pybind11::ssize_t height, pybind11::ssize_t width,
              const char* name, const char* of) {
  CheckDimensions(array, 2, name);
  if (array.shape(0) != height || array.shape(1) != width) {
    throw pybind11::value_error(std::string(name) + " must have the size of " + of);
  }
}

// The same of 3 planes.
template <typename T>
void CheckPlanes(const Array<T>& array, pybind11::ssize_t height, pybind11::ssize_t width,
                 const char* name, const char* of) {
  CheckDimensions(array, 3, name);
  if (array.shape(0) != 3 || array.shape(1) != height || array.shape(2) != width) {
    throw pybind11::value_error(std::string(name) + " must have 3 planes of the size of " + of);
  }
}

// Hands a result's array to numpy without a copy.
template <typename T>
pybind11::array_t<T> ToArray(std::vector<T>&& values, std::vector<pybind11::ssize_t> shape) {
  auto owned = std::make_unique<std::vector<T>>(std::move(values));
  const T* data = owned->data();
  pybind11::capsule owner(owned.release(), [](void* p) { delete static_cast<std::vector<T>*>(p); });
  return pybind11::array_t<T>(std::move(shape), data, owner);
}

}  // namespace sirpy
