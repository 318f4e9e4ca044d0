#include "bindings/bindings.h"

#include "error.h"

namespace py = pybind11;

PYBIND11_MODULE(_core, module) {
  module.doc() = "The C++ core of sirpy. Private: use the typed functions of the package.";

  // Mistakes in the user's data become sirpy.errors.InputError, files that cannot be written
  // OutputError; everything else raises as pybind11 has it.
  static py::handle input_error =
      py::object(py::module_::import("sirpy.errors").attr("InputError")).release();
  static py::handle output_error =
      py::object(py::module_::import("sirpy.errors").attr("OutputError")).release();
  py::register_exception_translator([](std::exception_ptr exception) {
    try {
      if (exception) std::rethrow_exception(exception);
    } catch (const sirpy::InputError& error) {
      PyErr_SetString(input_error.ptr(), error.what());
    } catch (const sirpy::OutputError& error) {
      PyErr_SetString(output_error.ptr(), error.what());
    }
  });

  sirpy::BindSubImage(module);
  sirpy::BindTiePoints(module);
  sirpy::BindSparseModel(module);
  sirpy::BindStereo(module);
  sirpy::BindPatchmatchnet(module);
  sirpy::BindFusion(module);
  sirpy::BindSurfaceModel(module);
  sirpy::BindSynthetic(module);
}
