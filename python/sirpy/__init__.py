"""sirpy: dense 3D reconstruction at native resolution by sub-image recapture.

Each stage is a function, and a command of the same name: `plan`, `cut`, `views`, `stereo`, `fuse`,
`report`; `reconstruct` runs them all. `recapture` gives one rectangle of one photograph, `export` serves other
engines. They are imported at use, so that `import sirpy` is quick. The cameras are made by `sirpy.sfm.sfm`.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Before the C++ core is loaded: idle OpenMP threads sleep. While rows are decoded by one thread the
# others would otherwise spin, which doubles the CPU time of a cut.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

if TYPE_CHECKING:
    from sirpy.area import read_area
    from sirpy.clustering import clusters
    from sirpy.cut_tasks import PixelOptions
    from sirpy.cutting import cut
    from sirpy.dense_stereo import stereo
    from sirpy.errors import SirpyError
    from sirpy.explaining import explain
    from sirpy.exporting import export
    from sirpy.fusion import FusionOptions, fuse
    from sirpy.html_report import report
    from sirpy.layout import Region
    from sirpy.lens import UndistortOptions
    from sirpy.model_files import read_model
    from sirpy.photographs import Encoding
    from sirpy.pipeline import reconstruct
    from sirpy.planning import plan
    from sirpy.recapturing import recapture
    from sirpy.rectangle import Grid, Rectangle
    from sirpy.sfm_options import SfmOptions
    from sirpy.stereo_backend import StereoOptions
    from sirpy.view_selection import views
    from sirpy.windows import read_window
    from sirpy.workspace import Workspace

_HOME = {
    "Encoding": "photographs",
    "FusionOptions": "fusion",
    "Grid": "rectangle",
    "PixelOptions": "cut_tasks",
    "Rectangle": "rectangle",
    "Region": "layout",
    "SfmOptions": "sfm_options",
    "SirpyError": "errors",
    "StereoOptions": "stereo_backend",
    "UndistortOptions": "lens",
    "Workspace": "workspace",
    "clusters": "clustering",
    "cut": "cutting",
    "explain": "explaining",
    "export": "exporting",
    "fuse": "fusion",
    "plan": "planning",
    "read_area": "area",
    "read_model": "model_files",
    "read_window": "windows",
    "recapture": "recapturing",
    "reconstruct": "pipeline",
    "report": "html_report",
    "stereo": "dense_stereo",
    "views": "view_selection",
}

__all__ = [
    "Encoding",
    "FusionOptions",
    "Grid",
    "PixelOptions",
    "Rectangle",
    "Region",
    "SfmOptions",
    "SirpyError",
    "StereoOptions",
    "UndistortOptions",
    "Workspace",
    "clusters",
    "cut",
    "explain",
    "export",
    "fuse",
    "plan",
    "read_area",
    "read_model",
    "read_window",
    "recapture",
    "reconstruct",
    "report",
    "stereo",
    "views",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sirpy' has no attribute '{name}'")
    return getattr(import_module(f"sirpy.{_HOME[name]}"), name)
