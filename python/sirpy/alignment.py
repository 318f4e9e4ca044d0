"""georeference.json: the frame of the products, where it comes from and how well that fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, cast, get_args

import numpy as np

from sirpy.errors import InputError
from sirpy.files import read_json, write_json
from sirpy.frame import Frame
from sirpy.workspace import Workspace

Source = Literal["exif", "positions", "control_points", "declared"]
Role = Literal["used", "check", "outlier"]

_VERSION = 1


@dataclass(frozen=True)
class Residual:
    """Of a photograph's position or of a point: where the model has it less where it should be, in the unit of
    the frame; `pixels`, of control points: distance in the photographs between the mark and the surveyed
    coordinates, rms over the marks."""

    name: str
    role: Role
    dx: float
    dy: float
    dz: float
    pixels: float | None = None


@dataclass(frozen=True)
class LeftOutMark:
    """A mark that does not fit the other marks of its point, by so many pixels."""

    image: str
    point: str
    pixels: float


@dataclass(frozen=True)
class Alignment:
    """What `georeference` found."""

    source: Source
    frame: Frame
    residuals: tuple[Residual, ...] = ()
    marks_left_out: tuple[LeftOutMark, ...] = ()

    @property
    def outliers(self) -> list[str]:
        return [one.name for one in self.residuals if one.role == "outlier"]

    def rms(self, role: Role = "used") -> dict[str, float]:
        """Of the residuals of a role: x, y, z, and pixels where there are some; empty without any."""
        some = [one for one in self.residuals if one.role == role]
        columns = {
            "x": [one.dx for one in some],
            "y": [one.dy for one in some],
            "z": [one.dz for one in some],
            "pixels": [one.pixels for one in some if one.pixels is not None],
        }
        return {name: _rms(values) for name, values in columns.items() if values}


def write_alignment(workspace: Workspace, alignment: Alignment) -> None:
    """Writes georeference.json, whole or not at all. Raises OutputError."""
    frame = alignment.frame
    write_json(
        workspace.georeference,
        {
            "version": _VERSION,
            "source": alignment.source,
            "crs": frame.crs,
            "frame": {
                "scale": frame.scale,
                "rotation": frame.rotation.tolist(),
                "translation": frame.translation.tolist(),
            },
            "residuals": [
                {key: value for key, value in asdict(one).items() if value is not None}
                | {"used": one.role == "used"}
                for one in alignment.residuals
            ],
            "rms": alignment.rms(),
            "check_rms": alignment.rms("check"),
            "outliers": alignment.outliers,
            "marks_left_out": [asdict(mark) for mark in alignment.marks_left_out],
        },
    )


def read_alignment(workspace: Workspace) -> Alignment | None:
    """What was written; None when there is no georeference.json.

    Raises:
        InputError: it is damaged, or of another version.
    """
    again = "run `sirpy georeference` again"

    def parsed(value: Any) -> Alignment:
        if value["version"] != _VERSION:
            raise InputError(
                f"{workspace.georeference} was made by another version of sirpy: {again}"
            )
        if value["source"] not in get_args(Source):
            raise ValueError(f"source = {value['source']}")
        return Alignment(
            cast(Source, value["source"]),
            _parsed_frame(value["crs"], value["frame"]),
            tuple(_parsed_residual(one) for one in value["residuals"]),
            tuple(
                LeftOutMark(str(mark["image"]), str(mark["point"]), float(mark["pixels"]))
                for mark in value["marks_left_out"]
            ),
        )

    try:
        return read_json(workspace.georeference, parsed, again)
    except FileNotFoundError:
        return None


def _parsed_frame(crs: Any, value: Any) -> Frame:
    scale = float(value["scale"])
    rotation = np.array(value["rotation"], np.float64).reshape(3, 3)
    translation = np.array(value["translation"], np.float64).reshape(3)
    if not (0 < scale < math.inf and np.isfinite(translation).all()):
        raise ValueError("its frame is no similarity")
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
        raise ValueError("its frame has no rotation")
    return Frame(None if crs is None else str(crs), scale, rotation, translation)


def _parsed_residual(value: Any) -> Residual:
    if value["role"] not in get_args(Role):
        raise ValueError(f"role = {value['role']}")
    pixels = value.get("pixels")
    return Residual(
        str(value["name"]),
        cast(Role, value["role"]),
        float(value["dx"]),
        float(value["dy"]),
        float(value["dz"]),
        None if pixels is None else float(pixels),
    )


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
