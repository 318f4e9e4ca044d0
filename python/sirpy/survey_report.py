"""What report.html shows of a survey: its plan, heights, orthophoto, coverage, and how well it fits its positions.

Each section is there when what it shows has been made.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from html import escape

import numpy as np

from sirpy.area import footprint
from sirpy.cloud import Cloud
from sirpy.frame import Floats, Frame
from sirpy.fusion import fused_parts
from sirpy.georeference import read_frame
from sirpy.native_scene import NativeCamera, NativeScene, read_native_scene
from sirpy.pictures import data_address, encoded_jpeg, encoded_png, turbo
from sirpy.rectangle import Rectangle
from sirpy.residual_plot import residuals
from sirpy.survey_pictures import (
    Image,
    ScaledPicture,
    coverage,
    photograph_from_above,
    shaded_heights,
)
from sirpy.workspace import Workspace

_NAMES_SHOWN = 60  # photographs; more would cover each other
_REACH = 3.0  # times the greatest depth of a photograph's points: rays above the horizon end there
_MARGIN = 0.03  # of the plan, around it
_GROUND = (
    0.5,
    99.5,
)  # percent of the sparse points in x and y that tell what a map of coverage holds,
_BEYOND = 0.08  # and this share of it on each side


def survey_sections(workspace: Workspace) -> Iterator[str]:
    """Sections of HTML.

    Raises InputError where a file is damaged.
    """
    scene, frame = None, Frame()
    if workspace.native_model.exists():
        scene, frame = read_native_scene(workspace), read_frame(workspace)
    if scene is not None and len(scene.points):
        yield _plan(workspace, scene, frame)
    yield residuals(workspace)
    if workspace.surface_model.exists():
        yield _heights(workspace, frame)
    if workspace.orthophoto.exists():
        yield _orthophoto(workspace)
    if scene is not None and len(scene.points) and workspace.fused_parts.exists():
        yield _coverage(Cloud(fused_parts(workspace), frame), scene)


def _plan(workspace: Workspace, scene: NativeScene, frame: Frame) -> str:
    ground = {name: _footprint(scene, name, frame) for name in scene.cameras}
    centres = frame.world(np.array([camera.centre for camera in scene.cameras.values()]))
    tiles = _tile_boxes(workspace)
    every = np.concatenate([*ground.values(), *tiles, centres[:, :2]])
    low, high = every.min(axis=0), every.max(axis=0)
    size = float((high - low).max()) or 1.0
    low, high = low - _MARGIN * size, high + _MARGIN * size

    def path(corners: Floats, style: str) -> str:
        places = " ".join(f"{x - low[0]:.6g},{high[1] - y:.6g}" for x, y in corners)
        return f'<polygon points="{places}" {style}/>'

    thin = size / 700
    seen = f'fill="#2f6fb5" fill-opacity=".07" stroke="#2f6fb5" stroke-width="{thin:.4g}"'
    cut = (
        f'fill="none" stroke="#c8501e" stroke-width="{thin:.4g}" stroke-dasharray="{4 * thin:.4g}"'
    )
    shapes = [path(corners, seen) for corners in ground.values() if len(corners)]
    shapes += [path(corners, cut) for corners in tiles]
    for name, (x, y, _) in zip(scene.cameras, centres, strict=True):
        at = x - low[0], high[1] - y
        shapes.append(
            f'<circle cx="{at[0]:.6g}" cy="{at[1]:.6g}" r="{4 * thin:.4g}" fill="#1d2530">'
            f"<title>{escape(name)}</title></circle>"
        )
        if len(centres) <= _NAMES_SHOWN:
            shapes.append(
                f'<text x="{at[0] + 7 * thin:.6g}" y="{at[1] + 4 * thin:.6g}" '
                f'font-size="{12 * thin:.4g}" fill="#1d2530">{escape(name)}</text>'
            )
    width, height = high - low
    where = f"in {escape(frame.crs)}, north at the top" if frame.crs else "in the local frame"
    also = "; dashed, the tiles" if tiles else ""
    return (
        f"<h2>The survey</h2><p>From above, {where}: what each photograph sees of the ground, and from "
        f'where{also}.</p><div class="card"><svg viewBox="0 0 {width:.6g} {height:.6g}" role="img" '
        f'font-family="system-ui, sans-serif">{"".join(shapes)}'
        f"{_scale_bar(float(width), float(height), thin, _unit(frame))}</svg></div>"
    )


def _footprint(scene: NativeScene, name: str, frame: Frame) -> Floats:
    """What a photograph sees of level ground at the median height of its points, (n, 2) of the frame."""
    seen = scene.observations[name]
    camera = _in_frame(scene.cameras[name], frame)
    if len(seen.point) == 0:
        return np.empty((0, 2))
    height = float(np.median(frame.world(scene.points[seen.point])[:, 2]))
    reach = _REACH * frame.scale * float(seen.depth.max())
    whole = Rectangle(0, 0, camera.width, camera.height)
    return footprint(camera, whole, (height, height), reach)


def _in_frame(camera: NativeCamera, frame: Frame) -> NativeCamera:
    """The camera whose world is the frame; depths are in its unit."""
    rotation = camera.cam_from_world[:, :3] @ frame.rotation.T
    shift = frame.scale * camera.cam_from_world[:, 3] - rotation @ frame.translation
    return replace(camera, cam_from_world=np.column_stack([rotation, shift]))


def _tile_boxes(workspace: Workspace) -> list[Floats]:
    """What the tiles hold, (4, 2) each."""
    import laspy
    import rasterio

    bounds = []
    for path in workspace.tiles_made("laz"):
        with laspy.open(path) as file:
            bounds.append((*file.header.mins[:2], *file.header.maxs[:2]))
    for path in workspace.tiles_made("dsm.tif"):
        with rasterio.open(path) as file:
            bounds.append(tuple(file.bounds))
    return [np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) for x0, y0, x1, y1 in bounds]


def _scale_bar(width: float, height: float, thin: float, unit: str) -> str:
    power = 10.0 ** np.floor(np.log10(width / 4))
    length = power * max(step for step in (1, 2, 5) if step * power <= width / 4)
    x, y = 10 * thin, height - 10 * thin
    return (
        f'<path d="M{x:.6g},{y:.6g}h{length:.6g}" stroke="#1d2530" stroke-width="{3 * thin:.4g}"/>'
        f'<text x="{x:.6g}" y="{y - 7 * thin:.6g}" font-size="{13 * thin:.4g}" fill="#1d2530">'
        f"{length:g}{unit}</text>"
    )


def _heights(workspace: Workspace, frame: Frame) -> str:
    made = shaded_heights(workspace.surface_model)
    return (
        "<h2>The surface model</h2><p>Heights with hill shade, light from the north-west; white where there "
        f'are none.</p><div class="card"><figure>{_picture(made.image, "Surface model")}'
        f"{_legend(made, _unit(frame))}</figure></div>"
    )


def _orthophoto(workspace: Workspace) -> str:
    image = photograph_from_above(workspace.orthophoto)
    return (
        '<h2>The orthophoto</h2><div class="card"><figure>'
        f"{_picture(image, 'Orthophoto')}</figure></div>"
    )


def _coverage(cloud: Cloud, scene: NativeScene) -> str:
    places = cloud.frame.world(scene.points)[:, :2]
    low, high = np.percentile(places, _GROUND, axis=0)
    low, high = low - _BEYOND * (high - low), high + _BEYOND * (high - low)
    if cloud.count == 0 or not (high > low).all():
        return ""
    count, views, side = coverage(cloud, low, high)
    cards = [
        f"<figure>{_picture(made.image, title, flat=True)}{_legend(made, '')}"
        f"<figcaption>{title}</figcaption></figure>"
        for made, title in [(count, "Points of each cell"), (views, "Photographs that agree")]
    ]
    return (
        f"<h2>What the cloud covers</h2><p>Cells of {side:.3g}{_unit(cloud.frame)}; white where there is no "
        f'point.</p><div class="card"><div class="pair">{"".join(cards)}</div></div>'
    )


def _picture(image: Image, title: str, *, flat: bool = False) -> str:
    address = (
        data_address(encoded_png(image), "png")
        if flat
        else data_address(encoded_jpeg(image), "jpeg")
    )
    return f'<img alt="{title}" src="{address}">'


def _legend(made: ScaledPicture, unit: str) -> str:
    colours = ",".join(f"rgb({r},{g},{b})" for r, g, b in turbo(np.linspace(0, 1, 12)).tolist())
    return (
        f'<div class="legend"><span>{made.low:.4g}{unit}</span>'
        f'<i style="background:linear-gradient(90deg,{colours})"></i>'
        f"<span>{made.high:.4g}{unit}</span></div>"
    )


def _unit(frame: Frame) -> str:
    return " m" if frame.crs else ""
