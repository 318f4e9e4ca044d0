// Checked views of numpy arrays: the type is exact (no silent conversion), C-contiguous, of the stated shape.
#pragma once

#include <string>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

namespace sirpy {

template <typename T>
using Array = pybind11::array_t<T, pybind11::array::c_style>;

// Throws ValueError in Python when `array` has not `dimensions` dimensions. Bind arguments with
// py::arg("name").noconvert() so that a wrong dtype or a strided array is refused too.
template <typename T>
void CheckDimensions(const Array<T>& array, int dimensions, const char* name) {
  if (array.ndim() != dimensions) {
    throw pybind11::value_error(std::string(name) + " must have " + std::to_string(dimensions) +
                                " dimensions, not " + std::to_string(array.ndim()));
  }
}

}  // namespace sirpy
