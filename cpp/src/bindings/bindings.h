// One binding function per stage; module.cc calls them in the order of the data flow.
#pragma once

#include <pybind11/pybind11.h>

namespace sirpy {

void BindSubImage(pybind11::module_& module);
void BindTiePoints(pybind11::module_& module);
void BindSparseModel(pybind11::module_& module);
void BindStereo(pybind11::module_& module);
void BindPatchmatchnet(pybind11::module_& module);
void BindFusion(pybind11::module_& module);
void BindSurfaceModel(pybind11::module_& module);
void BindSynthetic(pybind11::module_& module);

}  // namespace sirpy
