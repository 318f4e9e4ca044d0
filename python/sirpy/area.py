"""An area of interest on the ground, and which sub-images see it.

An area is polygons with holes in the (x, y) of the model's frame, whose z points up. A sub-image sees it where
the part of its frustum between the local heights of the sparse points, seen from above, touches a polygon.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sirpy.crs import WGS84, parse_crs
from sirpy.errors import InputError
from sirpy.native_images import NativeImage
from sirpy.native_scene import Floats, NativeCamera, NativeScene
from sirpy.rectangle import Rectangle
from sirpy.view_fields import observations_around

_COMPARED_AT_ONCE = 1_000_000  # pairs of a point and an edge
_PARTS_OF_AN_EDGE = 32  # straight in one CRS is bent in another
_HEIGHT_PERCENTILES = (1.0, 99.0)
_HEIGHT_MARGIN = 0.25  # of the local range of heights, on both sides
_LEAST_HEIGHT_MARGIN = 0.02  # of the depth
_FEWEST_HEIGHTS = 3
_REACH = 2.0  # times the largest depth of a photograph's points: rays above the horizon end there


@dataclass(frozen=True, eq=False)
class Area:
    """Polygons in the (x, y) of the model's frame: of each the outer ring and the holes.

    A ring is (n, 2), its last point the first; which way round does not matter.
    """

    polygons: tuple[tuple[Floats, ...], ...]

    def contains(self, points: Floats) -> npt.NDArray[np.bool_]:
        """Which of the points (n, 2) lie in a polygon and in none of its holes."""
        inside = np.zeros(len(points), bool)
        for rings in self.polygons:
            low, high = rings[0].min(axis=0), rings[0].max(axis=0)
            near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1) & ~inside)
            begin, end = _edges(rings)
            step = max(1, _COMPARED_AT_ONCE // len(begin))
            for first in range(0, len(near), step):
                some = near[first : first + step]
                inside[some] = _is_inside(points[some], begin, end)
        return inside

    def touches(self, convex: Floats) -> bool:
        """Whether a convex polygon (n, 2), counter-clockwise and not closed, shares a point with the
        area."""
        if len(convex) == 0:
            return False
        begin, end = self._all_edges
        low, high = convex.min(axis=0), convex.max(axis=0)
        near = ((np.maximum(begin, end) >= low) & (np.minimum(begin, end) <= high)).all(axis=1)
        begin, direction = begin[near], (end - begin)[near]
        side = np.roll(convex, -1, axis=0) - convex
        outward = np.column_stack([side[:, 1], -side[:, 0]])
        # Each edge of the area from t = enter to t = leave is inside all sides (Cyrus and Beck).
        distance = np.einsum("kc,ekc->ek", outward, begin[:, None] - convex[None])
        speed = direction @ outward.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -distance / speed
        enter = np.where(speed < 0, t, 0).max(axis=1).clip(min=0)
        leave = np.where(speed > 0, t, 1).min(axis=1).clip(max=1)
        outside = ((speed == 0) & (distance > 0)).any(axis=1)
        if ((enter <= leave) & ~outside).any():
            return True
        return bool(self.contains(convex).any())

    @cached_property
    def _all_edges(self) -> tuple[Floats, Floats]:
        return _edges([ring for rings in self.polygons for ring in rings])


def _edges(rings: Sequence[Floats]) -> tuple[Floats, Floats]:
    """(begin, end) of all edges of some rings, each (n, 2)."""
    return np.concatenate([r[:-1] for r in rings]), np.concatenate([r[1:] for r in rings])


def _is_inside(points: Floats, begin: Floats, end: Floats) -> npt.NDArray[np.bool_]:
    """Whether a ray from each point towards +x crosses an odd number of edges."""
    x, y = points[:, :1], points[:, 1:]
    crosses = (y < begin[:, 1]) != (y < end[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (y - begin[:, 1]) / (end - begin)[:, 1]
        at = begin[:, 0] + share * (end - begin)[:, 0]
    odd: npt.NDArray[np.bool_] = (crosses & (x < at)).sum(axis=1) % 2 == 1
    return odd


class AreaFilter:
    """Takes away the sub-images that cannot see an area.

    Never one that sees it: the heights are those of the sparse points around the sub-image (1 to 99 %) with a
    margin of a quarter of their range and 2 % of the depth, and a sub-image with a sparse point in the
    area stays in any case.
    """

    def __init__(self, area: Area, scene: NativeScene) -> None:
        if len(scene.points) == 0:
            raise InputError(
                "the model has no sparse points, which tell how high the ground of the area is: give "
                "a region of the photographs with --roi"
            )
        self._area = area
        self._scene = scene
        self._inside = area.contains(scene.points[:, :2])

    def __call__(self, native: NativeImage) -> NativeImage:
        """`native` with the sub-images that see the area; there may be none."""
        camera = self._scene.cameras[native.name]
        kept = [sub for sub in native.sub_images if self._sees(camera, native, sub.core)]
        return replace(native, sub_images=tuple(kept))

    def nothing_left(self) -> InputError:
        """What to say when no sub-image at all sees the area."""
        low, high = self._scene.points[:, :2].min(axis=0), self._scene.points[:, :2].max(axis=0)
        return InputError(
            "no photograph of the model sees the area: check its coordinates and CRS; the model's points "
            f"have x from {low[0]:.8g} to {high[0]:.8g} and y from {low[1]:.8g} to {high[1]:.8g}"
        )

    def _sees(self, camera: NativeCamera, native: NativeImage, core: Rectangle) -> bool:
        seen = self._scene.observations[native.name]
        x, y = seen.pixel.T
        inside = (x >= core.x0) & (x < core.x1) & (y >= core.y0) & (y < core.y1)
        if self._inside[seen.point[inside]].any():
            return True
        near = observations_around(self._scene, native.name, core)
        if len(near) < _FEWEST_HEIGHTS:
            away = np.linalg.norm(self._scene.points - camera.centre, axis=1)
            heights = _height_range(self._scene.points[:, 2], 0.0)
            return self._area.touches(footprint(camera, core, heights, _REACH * float(away.max())))
        least = _LEAST_HEIGHT_MARGIN * float(np.median(seen.depth[near]))
        heights = _height_range(self._scene.points[seen.point[near], 2], least)
        reach = _REACH * float(seen.depth.max())
        return self._area.touches(footprint(camera, core, heights, reach))


def footprint(
    camera: NativeCamera, rectangle: Rectangle, heights: tuple[float, float], reach: float
) -> Floats:
    """From above, all that a rectangle (native pixels) can see between two heights, up to a depth.

    Returns:
        The convex polygon in the model's (x, y), (n, 2), counter-clockwise; empty where it sees nothing
        there.
    """
    x0, y0, x1, y1 = rectangle.x0, rectangle.y0, rectangle.x1, rectangle.y1
    pixels = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    far = camera.world(pixels, np.full(4, reach))
    apex = np.broadcast_to(camera.centre, far.shape)
    # The corners of a convex body between two planes: its own, and where its edges meet the planes.
    begin, end = np.concatenate([apex, far]), np.concatenate([far, np.roll(far, -1, axis=0)])
    corners = [begin[(begin[:, 2] >= heights[0]) & (begin[:, 2] <= heights[1])]]
    for height in heights:
        crossed = (begin[:, 2] < height) != (end[:, 2] < height)
        a, b = begin[crossed], end[crossed]
        t = (height - a[:, 2]) / (b[:, 2] - a[:, 2])
        corners.append(a + t[:, None] * (b - a))
    return _convex_hull(np.concatenate(corners)[:, :2])


def read_area(
    path: Path | str, *, area_crs: str | None = None, model_crs: str | None = None
) -> Area:
    """The area of a GeoJSON file, in the model's frame.

    Args:
        path: Polygon, MultiPolygon, or features of these.
        area_crs: of the file's coordinates, e.g. EPSG:25832; if None what the file says in its member
            "crs", else longitude and latitude (WGS84), as RFC 7946 wants it.
        model_crs: of the model, projected; without it the file's coordinates are the model's own.

    Raises:
        InputError: the file is no area, or a CRS is unknown or cannot be used.
    """
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8-sig"))
        polygons = tuple(_polygons(document, path))
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"the area {path} cannot be read as GeoJSON ({error})") from None
    if not polygons:
        raise InputError(f"the area {path} holds no polygon: draw one around what is wanted")
    if model_crs is None:
        if area_crs is not None:
            raise InputError(
                f"--area_crs {area_crs} needs the CRS of the model too: give --model_crs, or leave "
                "both out when the area is in the model's own coordinates"
            )
        return Area(polygons)
    return Area(_converted(polygons, path, area_crs or _named_crs(document) or WGS84, model_crs))


def _polygons(value: Any, path: Path) -> Iterator[tuple[Floats, ...]]:
    """The polygons of any GeoJSON object."""
    kind = value.get("type") if isinstance(value, dict) else None
    many = {"FeatureCollection": "features", "GeometryCollection": "geometries"}
    if kind == "Feature" and value.get("geometry") is None:
        return
    if kind == "Feature":
        yield from _polygons(value["geometry"], path)
    elif kind in many:
        for part in _listed(value.get(many[kind]), path):
            yield from _polygons(part, path)
    elif kind == "Polygon":
        yield _rings(value.get("coordinates"), path)
    elif kind == "MultiPolygon":
        for rings in _listed(value.get("coordinates"), path):
            yield _rings(rings, path)
    else:
        raise InputError(
            f"the area {path} holds a {kind or 'value'} where a Polygon or MultiPolygon is needed: "
            "draw polygons"
        )


def _listed(value: Any, path: Path) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"the area {path} is no GeoJSON: a list is missing; export it again")
    return value


def _rings(value: Any, path: Path) -> tuple[Floats, ...]:
    rings = []
    for positions in _listed(value, path):
        try:
            ring = np.array([position[:2] for position in positions], np.float64).reshape(-1, 2)
        except (KeyError, TypeError, ValueError):
            raise InputError(
                f"the area {path} has a position that is not two numbers: export it again"
            ) from None
        if len(ring) < 4 or not np.isfinite(ring).all() or (ring[0] != ring[-1]).any():
            raise InputError(
                f"the area {path} has a ring that is not closed: it needs at least four positions, "
                "the last like the first"
            )
        rings.append(ring)
    if not rings:
        raise InputError(f"the area {path} has a polygon without a ring: export it again")
    return tuple(rings)


def _named_crs(document: Any) -> str | None:
    """The member "crs" of GeoJSON before RFC 7946, which GDAL still writes."""
    try:
        return str(document["crs"]["properties"]["name"])
    except (KeyError, TypeError):
        return None


def _converted(
    polygons: tuple[tuple[Floats, ...], ...], path: Path, area_crs: str, model_crs: str
) -> tuple[tuple[Floats, ...], ...]:
    from pyproj import Transformer

    source, target = parse_crs(area_crs, "--area_crs"), parse_crs(model_crs, "--model_crs")
    if not target.is_projected:
        raise InputError(
            f"--model_crs {model_crs} is not projected, so the model's x and y would not be lengths on "
            "the ground: give a projected one, such as a UTM zone"
        )
    move = Transformer.from_crs(source, target, always_xy=True)

    def converted(ring: Floats) -> Floats:
        share = np.arange(_PARTS_OF_AN_EDGE)[:, None] / _PARTS_OF_AN_EDGE
        parts = ring[:-1, None] + share * (ring[1:] - ring[:-1])[:, None]
        fine = np.concatenate([parts.reshape(-1, 2), ring[-1:]])
        moved = np.column_stack(move.transform(fine[:, 0], fine[:, 1]))
        if not np.isfinite(moved).all():
            raise InputError(
                f"the area {path} has positions that {area_crs} or {model_crs} does not know: give the "
                "CRS of its coordinates with --area_crs"
            )
        return moved

    return tuple(tuple(converted(ring) for ring in rings) for rings in polygons)


def _height_range(heights: Floats, least_margin: float) -> tuple[float, float]:
    low, high = np.percentile(heights, _HEIGHT_PERCENTILES)
    margin = max(_HEIGHT_MARGIN * (high - low), least_margin)
    return float(low - margin), float(high + margin)


def _convex_hull(points: Floats) -> Floats:
    """Corners of the convex hull of (n, 2), counter-clockwise (Andrew's monotone chain)."""
    ordered = np.unique(points, axis=0)
    if len(ordered) < 3:
        return ordered

    def chain(points: Floats) -> list[Floats]:
        kept: list[Floats] = []
        for point in points:
            while len(kept) >= 2 and _turn(kept[-2], kept[-1], point) <= 0:
                kept.pop()
            kept.append(point)
        return kept[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _turn(a: Floats, b: Floats, c: Floats) -> float:
    """Positive where a, b, c turn left."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
