"""Native recapture beside decimation: photographs and cameras scaled down, then the same reconstruction."""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import rasterio
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning
from reconstruction import check_new, measured
from sirpy.model_arrays import SparseModel, read_arrays, write_model
from sirpy.pictures import encoded_jpeg

_LINE = 14  # of text, in the plot
_QUALITY = 98  # of the decimated JPEG files
_THRESHOLDS = {"f1_1": "#c2410c", "f1_2": "#1d6fb8", "f1_5": "#3f7d3a"}


def compare(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One row for native recapture and one for each width; writes OUT/decimation.svg of them."""
    scene, output = arguments.scene, arguments.output
    model = read_arrays(scene / "sparse")
    longest = max(max(camera.width, camera.height) for camera in model.cameras.values())
    rows: list[dict[str, Any]] = []
    for width in [longest, *arguments.widths]:
        native = width == longest
        kind = "native" if native else "decimated"
        photographs = scene if native else output / f"photographs_{width}"
        if not native:
            check_new(photographs)
            decimate(scene / "images", model, width, photographs)
        row = measured(
            photographs / "images",
            output / f"{kind}_{width}",
            photographs / "sparse",
            arguments.memory,
            arguments.grid if native else arguments.decimated_grid,
            arguments.judge,
        )
        rows.append({"photographs": kind, "width": width, **row})
        yield rows[-1]
    judged = [row for row in rows if row["quality"]]
    if judged:
        (output / "decimation.svg").write_text(plot(judged), encoding="utf-8")


def decimate(images: Path, model: SparseModel, longest: int, output: Path) -> None:
    """Writes OUTPUT/images and OUTPUT/sparse: longest sides of `longest` pixels, the same poses."""
    warnings.simplefilter("ignore", NotGeoreferencedWarning)
    scaled = scaled_model(model, longest)
    write_model(scaled, output / "sparse")
    for image in scaled.images:
        camera = scaled.camera_of(image)
        pixels = np.empty((camera.height, camera.width, 3), np.uint8)
        with rasterio.open(images / image.name) as file:
            for channel in range(3):
                lower = area_mean(file.read(channel + 1), camera.height, axis=0)
                pixels[..., channel] = np.round(area_mean(lower, camera.width, axis=1))
        target = output / "images" / image.name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(encoded_jpeg(pixels, _QUALITY))


def scaled_model(model: SparseModel, longest: int) -> SparseModel:
    """The model of photographs whose longest sides have `longest` pixels; cameras that see less stay."""
    return rescaled(model, lambda camera: min(1, longest / max(camera.width, camera.height)))


def rescaled(model: SparseModel, scale_of: Callable[[pycolmap.Camera], float]) -> SparseModel:
    """The model of photographs of another size, by camera, rounded to whole pixels.

    Pixel coordinates begin at the outer corner of the first pixel, so that they only scale.
    """
    cameras = {}
    for number, camera in model.cameras.items():
        small, scale = pycolmap.Camera(camera.todict()), scale_of(camera)
        small.rescale(round(camera.width * scale), round(camera.height * scale))
        cameras[number] = small
    xy = model.xy.copy()
    for index, image in enumerate(model.images):
        old, new = model.camera_of(image), cameras[image.camera_id]
        xy[model.seen(index)] *= [new.width / old.width, new.height / old.height]
    return replace(model, cameras=cameras, xy=xy)


def area_mean(pixels: NDArray[Any], size: int, axis: int) -> NDArray[np.float64]:
    """`pixels` with `size` samples along `axis`, each the mean over the stretch that it covers."""
    old = pixels.shape[axis]
    edges = np.linspace(0, old, size + 1)
    whole = np.minimum(edges.astype(int), old - 1)
    shape = [-1 if i == axis else 1 for i in range(pixels.ndim)]
    sums = np.cumsum(pixels, axis, dtype=np.float64)
    before = sums - pixels  # up to the beginning of each pixel
    part = (edges - whole).reshape(shape)
    reached = before.take(whole, axis) + part * pixels.take(whole, axis)
    means: NDArray[np.float64] = np.diff(reached, axis=axis) * (size / old)
    return means


def plot(rows: list[dict[str, Any]]) -> str:
    """SVG of F1 against the width of the photographs, a line for each threshold."""
    rows = sorted(rows, key=lambda row: row["width"])
    left, right, top, bottom = 56, 500, 50, 300
    widest: int = rows[-1]["width"]

    def x(width: float) -> float:
        return left + (right - left) * width / widest

    def y(f1: float) -> float:
        return bottom - (bottom - top) * f1

    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 620 360" font-family="sans-serif" '
        'font-size="12" fill="#333">',
        '<rect width="620" height="360" fill="white"/>',
    ]
    for tenth in range(0, 11, 2):
        level = y(tenth / 10)
        parts.append(f'<path d="M{left} {level:.1f}H{right}" stroke="#ddd"/>')
        parts.append(
            f'<text x="{left - 8}" y="{level + 4:.1f}" text-anchor="end">{tenth / 10:g}</text>'
        )
    for row in rows:
        place = f'x="{x(row["width"]):.1f}" text-anchor="middle"'
        parts.append(f'<text {place} y="{bottom + 18}">{row["width"]}</text>')
        if row["photographs"] == "native":
            parts.append(f'<text {place} y="{bottom + 33}">native recapture</text>')
    middle = (left + right) / 2
    parts.append(
        f'<text x="{middle}" y="352" text-anchor="middle">longest side of the photographs, pixels</text>'
    )
    parts.append(f'<text x="{left}" y="40" text-anchor="middle">F1</text>')
    for key, colour in _THRESHOLDS.items():
        places = [(x(row["width"]), y(row["quality"][key])) for row in rows]
        line = " ".join(f"{across:.1f},{down:.1f}" for across, down in places)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [
            f'<circle cx="{across:.1f}" cy="{down:.1f}" r="4" fill="{colour}"/>'
            for across, down in places
        ]
    for row in rows:
        below = float("inf")
        for key, colour in _THRESHOLDS.items():  # a looser threshold never has less
            below = min(y(row["quality"][key]) - 8, below - _LINE)
            name = f" at {key.removeprefix('f1_')} GSD" if row is rows[-1] else ""
            anchor, shift = ("start", 8) if name else ("middle", 0)
            parts.append(
                f'<text x="{x(row["width"]) + shift:.1f}" y="{below:.1f}" text-anchor="{anchor}" '
                f'fill="{colour}">{row["quality"][key]:.2f}{name}</text>'
            )
    return "\n".join([*parts, "</svg>\n"])
