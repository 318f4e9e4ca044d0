#include "bindings/bindings.h"

namespace py = pybind11;

namespace sirpy {

void BindSubImage(py::module_& /*module*/) {}

}  // namespace sirpy
