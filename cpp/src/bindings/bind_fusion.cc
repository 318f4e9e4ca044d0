#include "bindings/bindings.h"

namespace py = pybind11;

namespace sirpy {

void BindFusion(py::module_& /*module*/) {}

}  // namespace sirpy
