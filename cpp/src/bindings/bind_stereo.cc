#include "bindings/bindings.h"

namespace py = pybind11;

namespace sirpy {

void BindStereo(py::module_& /*module*/) {}

}  // namespace sirpy
