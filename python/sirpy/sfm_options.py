"""What structure from motion can be asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from sirpy.errors import InputError
from sirpy.initial_cameras import CameraPer, check_camera_options
from sirpy.photographs import check_choice

Matcher = Literal["auto", "exhaustive", "sequential", "spatial"]
Mapper = Literal["incremental", "global"]
Gps = Literal["auto", "off", "use"]

_SMALLEST_SIDE = 64  # px: below, SIFT finds nothing


@dataclass(frozen=True)
class SfmOptions:
    """Options of structure from motion on decimated photographs."""

    max_image_size: int = 2304  # longest side of the decimated photographs, px
    camera_model: str = "OPENCV"  # COLMAP's name, of the model that comes out
    camera_per: CameraPer = "auto"  # what shares a camera: see lens_groups
    matcher: Matcher = "auto"  # by the number of photographs and their GPS
    mapper: Mapper = "incremental"
    gps: Gps = "auto"  # auto: which pairs are matched; use: also where the cameras are
    rig: Path | None = None  # cameras that are exposed together, as COLMAP's rig_config.json

    def __post_init__(self) -> None:
        check_camera_options(self.camera_model, self.camera_per)
        check_choice("matcher", self.matcher, get_args(Matcher))
        check_choice("mapper", self.mapper, get_args(Mapper))
        check_choice("gps", self.gps, get_args(Gps))
        if self.max_image_size < _SMALLEST_SIDE:
            raise InputError(
                f"max_image_size = {self.max_image_size} is not possible: it must be "
                f"{_SMALLEST_SIDE} or more"
            )
        if self.gps == "off" and self.matcher == "spatial":
            raise InputError(
                "matcher = 'spatial' needs GPS, and gps = 'off': choose one of the two"
            )
        if self.rig is not None and self.camera_per != "auto":
            raise InputError(
                f"camera_per = {self.camera_per!r} is not possible with a rig, which has one camera "
                "for each image_prefix: leave it at auto"
            )
