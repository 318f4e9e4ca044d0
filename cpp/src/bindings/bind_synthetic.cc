#include "bindings/bindings.h"

namespace py = pybind11;

namespace sirpy {

void BindSynthetic(py::module_& /*module*/) {}

}  // namespace sirpy
