"""View fields: what every part of a native image is matched against, and between which depths.

A field has square blocks, counted from the corner of the native image (top-left pixel, (0, 0)). The sparse points
in and around a block tell where its surface is expected (z in the reference camera, robust percentiles). Sources are
the native images that see that surface, under good angles at a like resolution (the score of OpenMVS); points that
they share count too, but are no condition. So what a pixel is given never depends on how the photographs are cut.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sirpy.ground import POINTS_OF_A_BLOCK, find_ground, ground_points
from sirpy.native_scene import (
    Floats,
    Indices,
    NativeCamera,
    NativeScene,
    Observations,
)
from sirpy.rectangle import Rectangle

MOST_SOURCES = 32  # in the table of a native image: bits of a mask
MOST_OF_A_BLOCK = 16  # sources that a place is matched against
MOST_LEVELS = 3  # that a source is read coarser

_BLOCKS_OF_A_SIDE = 8  # about, of the longest side
_BLOCK_STEP = 128  # native pixels: whole pixels of every pyramid level, at every border of a block
_ENOUGH_POINTS = 60  # that give a depth range and a choice of sources
_FEWEST_POINTS = 3
_ENOUGH_SOURCES = 3  # of every pixel that so many see
_OWN_POINTS = 10  # of a block: with less, it sees the ground that the rest of the image sees
_MIN_SHARED = 8  # sparse points that a source must share with the reference
_PERCENTILES = (1.0, 99.0)  # of the inverse depths
_MARGIN = 0.25  # of the range of inverse depths, on both sides
_LEAST_MARGIN = 0.02  # of the inverse depth
_MOST_BEYOND = 2.0  # times as deep as the deepest points
_FAR = 2.0**30  # pixels: beyond every image


@dataclass(frozen=True)
class FieldSource:
    """A native image in another one's table of sources.

    It is read `level` pyramid levels (powers of two, 0 to 3) coarser than the reference, because it
    samples the surface more finely.
    """

    name: str
    level: int


@dataclass(frozen=True)
class ViewField:
    """What the pixels of a native image are matched against and between which depths, block by block.

    The arrays are (rows, columns) of blocks. Bit j of `allowed`: `sources[j]` is matched against
    there. Depths are z in the reference camera, where the surface is expected: above 0 where a
    source is allowed, and 0 where too few sparse points are seen to tell them.
    """

    name: str
    side: int  # native pixels: about an eighth of the longest side, a multiple of 128
    sources: tuple[FieldSource, ...]  # at most MOST_SOURCES, the best first
    allowed: npt.NDArray[np.uint32]
    min_depth: npt.NDArray[np.float32]
    max_depth: npt.NDArray[np.float32]

    def blocks(self, window: Rectangle) -> tuple[slice, slice]:
        """(rows, columns) of the blocks that touch a window inside the image (native pixels)."""
        return (
            slice(window.y0 // self.side, -(-window.y1 // self.side)),
            slice(window.x0 // self.side, -(-window.x1 // self.side)),
        )

    def num_sources(self, window: Rectangle) -> npt.NDArray[np.uint8]:
        """How many sources each pixel of a window is matched against, (height, width)."""
        counts = np.array([int(bits).bit_count() for bits in self.allowed.flat], np.uint8)
        rows = np.arange(window.y0, window.y1) // self.side
        columns = np.arange(window.x0, window.x1) // self.side
        of_pixels: npt.NDArray[np.uint8] = counts.reshape(self.allowed.shape)[np.ix_(rows, columns)]
        return of_pixels

    def parts(self, window: Rectangle) -> list[Rectangle]:
        """What of a window lies in each of the blocks that it touches, row by row."""
        rows, columns = self.blocks(window)
        return [
            Rectangle(column * self.side, row * self.side, self.side, self.side).intersection(
                window
            )
            for row in range(rows.start, rows.stop)
            for column in range(columns.start, columns.stop)
        ]


def view_field(
    scene: NativeScene, name: str, *, num_sources: int, cut: Container[str] | None = None
) -> ViewField:
    """The field of a native image.

    Args:
        num_sources: that a block is matched against; a few more where some of its pixels would
            have less than three.
        cut: names of the native images that can be sources; all if None.
    """
    camera, seen = scene.cameras[name], scene.observations[name]
    side, rows, columns = field_shape(camera.width, camera.height)
    empty = np.zeros((rows, columns), np.float32)
    field = ViewField(name, side, (), empty.astype(np.uint32), empty, empty)
    blocks = field.parts(Rectangle(0, 0, camera.width, camera.height))
    near = [observations_around(scene, name, block) for block in blocks]
    if min(map(len, near)) < _FEWEST_POINTS:  # then the whole image sees no more
        return field
    inverse = np.array([np.percentile(1 / seen.depth[some], _PERCENTILES) for some in near])
    expected, near, points = _with_ground(scene, name, blocks, near, inverse)
    # As float32 already here: what is visible is judged between the depths that stereo is given.
    shape = (rows, columns, 2)
    depths = _depth_ranges(inverse.reshape(shape), expected.reshape(shape)).astype(np.float32)
    corners = frustum_corners(camera, blocks, depths.reshape(-1, 2))
    pairs = _shared_points(scene, name, *points)
    visible: dict[str, npt.NDArray[np.bool_]] = {}

    def is_source(other: str, block: int) -> bool:
        if cut is not None and other not in cut:
            return False
        if other not in visible:
            visible[other] = _visible(scene.cameras[other], corners)
        return bool(visible[other][block])

    chosen = []
    for block, some in enumerate(near):
        ranked = [other for other in pairs.scores(some, least=1) if is_source(other, block)]
        samples = some[-POINTS_OF_A_BLOCK:]
        chosen.append(_chosen(ranked, num_sources, pairs.seen_by(ranked, samples)))
    table = _best(chosen)
    bit = {other: 1 << index for index, other in enumerate(table)}
    allowed = [sum(bit[other] for other in names if other in bit) for names in chosen]
    return ViewField(
        name,
        side,
        tuple(FieldSource(other, pairs.level(other)) for other in table),
        np.array(allowed, np.uint32).reshape(rows, columns),
        np.ascontiguousarray(depths[..., 0]),
        np.ascontiguousarray(depths[..., 1]),
    )


def field_shape(width: int, height: int) -> tuple[int, int, int]:
    """(side of a block in native pixels, rows, columns) of the field of an image of this size."""
    steps = round(max(width, height) / (_BLOCKS_OF_A_SIDE * _BLOCK_STEP))
    side = max(1, steps) * _BLOCK_STEP
    return side, -(-height // side), -(-width // side)


def source_scores(scene: NativeScene, name: str, rectangle: Rectangle) -> dict[str, float]:
    """Native images by their score as sources of a rectangle (native pixels), the best first.

    The points are those in the rectangle or, where they are few, around it, as for the field.
    """
    near = observations_around(scene, name, rectangle)
    points = scene.observations[name].point[near]
    pairs = _shared_points(scene, name, *_seen_points(scene, points))
    return pairs.scores(np.arange(len(near)))


def points_seen(scene: NativeScene, name: str, rectangle: Rectangle) -> int:
    """How many sparse points a native image sees in a rectangle (native pixels)."""
    return int(np.count_nonzero(_inside(scene.observations[name], rectangle)))


def observations_around(scene: NativeScene, name: str, rectangle: Rectangle) -> Indices:
    """Indices of a native image's observations in a region around a rectangle that grows until it
    holds enough."""
    camera, seen = scene.cameras[name], scene.observations[name]
    whole = Rectangle(0, 0, camera.width, camera.height)
    margin = _margin(rectangle)
    while True:
        region = rectangle.padded(margin)
        inside = _inside(seen, region)
        if np.count_nonzero(inside) >= _ENOUGH_POINTS or region.contains(whole):
            return np.flatnonzero(inside)
        margin *= 2


def _margin(rectangle: Rectangle) -> int:
    """Pixels around a rectangle whose points are as good as its own."""
    return max(1, max(rectangle.width, rectangle.height) // 8)


def _with_ground(
    scene: NativeScene, name: str, blocks: list[Rectangle], near: list[Indices], inverse: Floats
) -> tuple[Floats, list[Indices], _SeenPoints]:
    """What is expected of the blocks, with the ground that the whole image sees.

    Args:
        near: indices of the observations around each block.
        inverse: (blocks, 2), their least and greatest inverse depths.

    Returns:
        `inverse`, where a block holds hardly a point with the range of the ground; `near`, each with
        POINTS_OF_A_BLOCK points of the surface as its last; the points that it is of: those that the image
        observes, then those of the surface.
    """
    seen = scene.observations[name]
    ground = find_ground(seen)
    expected, near = inverse.copy(), list(near)
    for index, block in enumerate(blocks):
        if np.count_nonzero(_inside(seen, block.padded(_margin(block)))) < _OWN_POINTS:
            low, high = ground.range_of(block)
            expected[index] = min(inverse[index, 0], low), max(inverse[index, 1], high)
        own = len(seen.point) + POINTS_OF_A_BLOCK * index + np.arange(POINTS_OF_A_BLOCK)
        near[index] = np.concatenate([near[index], own])
    world, point, observer = ground_points(scene, name, ground, blocks, expected)
    lying = world, len(seen.point) + point, observer
    observed = _seen_points(scene, seen.point)
    points = tuple(map(np.concatenate, zip(observed, lying, strict=True)))
    return expected, near, points  # type: ignore[return-value]


def _chosen(ranked: list[str], num_sources: int, sees: npt.NDArray[np.bool_]) -> list[str]:
    """The best sources of a block, and more where some of its surface is seen by less than three of them.

    Args:
        ranked: native images, the best first.
        sees: (images, samples), which samples of the surface each of them sees.
    """
    chosen = list(range(min(num_sources, len(ranked))))
    while len(chosen) < min(len(ranked), MOST_OF_A_BLOCK):
        lacking = sees[chosen].sum(axis=0) < min(_ENOUGH_SOURCES, num_sources)
        gain = (sees & lacking).sum(axis=1)
        gain[chosen] = 0
        best = int(np.argmax(gain))
        if gain[best] == 0:
            break
        chosen.append(best)
    return [ranked[index] for index in sorted(chosen)]


def frustum_corners(
    reference: NativeCamera, rectangles: list[Rectangle], depths: npt.NDArray[np.floating]
) -> Floats:
    """Corners in the world, (n, 8, 3), of what n rectangles of the reference (native pixels) see
    between two depths each, (n, 2)."""
    sides = np.array([(one.x0, one.y0, one.x1, one.y1) for one in rectangles], np.float64)
    pixels = np.tile(sides.reshape(-1, 4)[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2), (1, 2, 1))
    along = np.repeat(depths.astype(np.float64), 4, axis=1)
    return reference.world(pixels.reshape(-1, 2), along.ravel()).reshape(-1, 8, 3)


def projected_boxes(source: NativeCamera, corners: Floats) -> Floats:
    """(n, 4): x0, y0, x1, y1 around the projections of n frustums (see `frustum_corners`), pixels.

    A frustum is convex, so the box of its corners holds all of it. Where a corner lies behind the
    source nothing can be said, and the box is larger than any image.
    """
    seen = source.in_camera(corners.reshape(-1, 3)).reshape(-1, 8, 3)
    front = (seen[..., 2] > 0).all(axis=1)
    boxes = np.tile([-_FAR, -_FAR, _FAR, _FAR], (len(corners), 1))
    homogeneous = seen[front] @ source.intrinsics.T
    pixels = homogeneous[..., :2] / homogeneous[..., 2:]
    boxes[front] = np.concatenate([pixels.min(axis=1), pixels.max(axis=1)], axis=1)
    clipped: Floats = np.clip(boxes, -_FAR, _FAR)
    return clipped


# Points, world (p, 3), and who sees them: pairs (point, index of a camera), those of a point together.
_SeenPoints = tuple[Floats, Indices, Indices]


@dataclass(frozen=True)
class _SharedPoints:
    """Pairs (point of the reference, other native image that sees it), those of a point together."""

    names: list[str]  # of the other native images
    start: Indices  # (points + 1,): point i has the pairs start[i] to start[i + 1]
    other: Indices  # (pairs,) index into names
    weight: Floats  # (pairs,)
    finer: Floats  # (pairs,) GSD of the reference by that of the other

    def scores(self, points: Indices, least: int | None = None) -> dict[str, float]:
        """Scores over some of the points, the best first; images with less than `least` of them, or hardly one,
        are left out."""
        chosen = _joined(self.start[points], self.start[points + 1])
        other = self.other[chosen]
        score = np.bincount(other, self.weight[chosen], minlength=len(self.names))
        shared = np.bincount(other, minlength=len(self.names))
        enough = least or min(_MIN_SHARED, max(_FEWEST_POINTS, len(points) // 4))
        order = np.argsort(-score, kind="stable")
        return {
            self.names[i]: float(score[i]) for i in order if score[i] > 0 and shared[i] >= enough
        }

    def seen_by(self, names: list[str], points: Indices) -> npt.NDArray[np.bool_]:
        """Which of some points each image sees, (names, points)."""
        sees = np.zeros((len(self.names), len(points)), bool)
        chosen = _joined(self.start[points], self.start[points + 1])
        which = np.repeat(np.arange(len(points)), self.start[points + 1] - self.start[points])
        sees[self.other[chosen], which] = True
        return sees[[self.names.index(name) for name in names]]

    def level(self, name: str) -> int:
        """Pyramid levels by which another image samples the surface more finely, none if less."""
        ratio = np.median(self.finer[self.other == self.names.index(name)])
        return min(max(0, round(float(np.log2(ratio)))), MOST_LEVELS)


def _seen_points(scene: NativeScene, points: Indices) -> _SeenPoints:
    start, camera = scene.observers
    observer = camera[_joined(start[points], start[points + 1])]
    which = np.repeat(np.arange(len(points)), start[points + 1] - start[points])
    return scene.points[points], which, observer


def _shared_points(
    scene: NativeScene, reference: str, points: Floats, which: Indices, observer: Indices
) -> _SharedPoints:
    """Only the cameras that see one of the points are touched: the work hardly grows with the number of
    photographs.

    Args:
        points: (p, 3), world.
        which, observer: pairs of a point and the camera that sees it, those of a point together.
    """
    every = list(scene.cameras)
    apart = observer != every.index(reference)
    observer, which = observer[apart], which[apart]
    sees = np.zeros(len(every), bool)
    sees[observer] = True
    names = [every[i] for i in np.flatnonzero(sees)]
    other = (np.cumsum(sees) - 1)[observer]

    own, cameras = scene.cameras[reference], [scene.cameras[name] for name in names]
    centres = np.array([one.centre for one in cameras]).reshape(-1, 3)
    focals = np.array([one.intrinsics[0, 0] for one in cameras])
    axes = np.array([one.cam_from_world[2, :3] for one in cameras]).reshape(-1, 3)
    # From the cameras to the points.
    here, there = points - own.centre, points[which] - centres[other]
    here_distance, there_distance = _length(here)[which], _length(there)
    own_focal, focal = own.intrinsics[0, 0], focals[other]
    ratio = (here_distance / own_focal) / (there_distance / focal)
    cosine = _dot(here[which], there) / (here_distance * there_distance)
    depth, own_depth = _dot(axes[other], there), (here @ own.cam_from_world[2, :3])[which]
    first = np.zeros(len(points) + 1, np.int64)
    np.cumsum(np.bincount(which, minlength=len(points)), out=first[1:])
    weight = _angle_weight(cosine) * _scale_weight(ratio)
    return _SharedPoints(names, first, other, weight, (own_depth / own_focal) / (depth / focal))


def _dot(a: Floats, b: Floats) -> Floats:
    """Of the rows of two arrays (n, 3), (n,)."""
    product: Floats = np.einsum("ij,ij->i", a, b)
    return product


def _length(a: Floats) -> Floats:
    length: Floats = np.sqrt(_dot(a, a))
    return length


def _angle_weight(cosine: Floats) -> Floats:
    """OpenMVS: best at 12 degrees; less than one is better than nothing."""
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    sigma = np.where(angle < 12, 0.38 * 12, 0.7 * 12)
    weight: Floats = np.maximum(np.exp(-((angle - 12) ** 2) / (2 * sigma**2)), 0.1)
    weight *= np.minimum(angle, 1.0) ** 2
    return weight


def _scale_weight(ratio: Floats) -> Floats:
    """OpenMVS: a source may be finer by up to 1.6, other ratios count less."""
    fine = np.where(ratio > 1.6, (1.6 / ratio) ** 2, 1.0)
    return np.where(ratio < 1, ratio**2, fine)


def _joined(begin: Indices, end: Indices) -> Indices:
    """The whole numbers begin[0] to end[0], begin[1] to end[1] ..., without the ends."""
    count = end - begin
    offset: Indices = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.repeat(begin, count) + offset


def _visible(source: NativeCamera, corners: Floats) -> npt.NDArray[np.bool_]:
    """Whether a part of each frustum (see `frustum_corners`) may lie inside the image of the source."""
    x0, y0, x1, y1 = projected_boxes(source, corners).T
    inside: npt.NDArray[np.bool_] = (x0 < source.width) & (y0 < source.height) & (x1 > 0) & (y1 > 0)
    return inside


def _best(choices: list[list[str]]) -> list[str]:
    """Names that were chosen, MOST_SOURCES at most: the best of each block come before the second best
    of any, and what is best in more blocks before what is in fewer."""
    places: dict[str, Counter[int]] = {}
    for names in choices:
        for place, name in enumerate(names):
            places.setdefault(name, Counter())[place] += 1
    longest = max(map(len, choices))
    return sorted(
        places, key=lambda name: ([-places[name][place] for place in range(longest)], name)
    )[:MOST_SOURCES]


def _depth_ranges(inverse: Floats, expected: Floats) -> Floats:
    """(rows, columns, 2): nearest and farthest depth of each block, with margins.

    A range is joined with those of the 8 blocks around it, so that a roof is not cut off whose sparse
    points fall into the next block; beyond the border of the image with what would go on in a
    straight line, since the ground does go on where the points end.

    Args:
        inverse: (rows, columns, 2), least and greatest inverse depth of the sparse points; it is
            linear over a plane.
        expected: the same, with what is expected where hardly a point is seen.
    """
    beyond = np.pad(expected, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    found = np.empty_like(inverse)
    for row, column in np.ndindex(*inverse.shape[:2]):
        around = beyond[row : row + 3, column : column + 3]
        seen = inverse[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        low, high = around[..., 0].min(), around[..., 1].max()
        margin = max(_MARGIN * (high - low), _LEAST_MARGIN * (low + high) / 2)
        farthest = max(low - margin, seen[..., 0].min() / _MOST_BEYOND)
        found[row, column] = 1 / (high + margin), 1 / farthest
    return found


def _inside(seen: Observations, rectangle: Rectangle) -> npt.NDArray[np.bool_]:
    x, y = seen.pixel[:, 0], seen.pixel[:, 1]
    return (x >= rectangle.x0) & (x < rectangle.x1) & (y >= rectangle.y0) & (y < rectangle.y1)
