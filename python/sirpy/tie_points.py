"""Tie points of a sparse model, measured anew at native resolution: small squares are recaptured from the
photographs, each decoded once, and matched by least squares (cpp/src/tie_points).

A tie point keeps its identity, not its place: in one photograph, its reference, it moves to the best textured
pixel nearby, and the others are searched for that pixel around where the sparse model sees it. Photographs that
should see a point join in, whether or not the decimated features did.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.errors import InputError, OutputError
from sirpy.left_out import leave_out
from sirpy.model_arrays import Floats, SparseModel
from sirpy.native_images import LeftOut
from sirpy.patch_store import PatchStore, cut_patches
from sirpy.progress import Progress
from sirpy.tie_point_views import Ints, LocalPlanes, Views, choose_views

MATCHED = 0
STATUS = ("matched", "outside", "saturated", "unlike", "ambiguous", "distorted", "weak")
"""How a match ends, in the order of cpp/src/tie_points/least_squares_matching.h."""

_RADIUS = 10  # px of the window: a larger one has more texture, and more relief
_TEXTURE_RADIUS = 6  # px that a point may move to better texture
_LARGEST_SCALE = 1.5  # of the pixels of the others to the reference's that squares are cut for
_LEAST_SEARCH, _MOST_SEARCH = 6, 16  # px
_SEARCH = 6.0  # mean reprojection errors that the search reaches
_SATURATED = 250 / 255  # of white
# What least squares do not know of: relief within the window, interpolation, JPEG.
_FLOOR = 0.05  # px
_BATCH = 1000  # matches whose squares are in memory at once


@dataclass(frozen=True)
class TiePoints:
    """m observations, sorted by photograph; of each point at least two.

    Attributes:
        image, point: (m,) indices of model.images and model.points.
        xy: (m, 2) native pixels.
        covariance: (m, 2, 2) px^2.
        status: (images, len(STATUS)), how many searches in each photograph ended so.
        left_out: photographs that could not be read.
    """

    image: Ints
    point: Ints
    xy: Floats
    covariance: Floats
    status: Ints
    left_out: tuple[LeftOut, ...]


def measure_tie_points(
    images: Path,
    model: SparseModel,
    scratch: Path,
    *,
    threads: int,
    progress: Progress | None = None,
) -> TiePoints:
    """Measures the tie points of `model`, a model in native pixels, in the photographs of `images`.

    The squares of one photograph (13 kB each) and of one batch of matches (26 MB) are in memory; those of all
    lie in the folder `scratch` meanwhile, which is emptied first and removed at last.

    Raises:
        OutputError: `scratch` cannot be written.
    """
    progress = progress or Progress()
    views = choose_views(model)
    search = _search_radius(model)
    half = math.ceil(_LARGEST_SCALE * (_RADIUS + search + _TEXTURE_RADIUS)) + 3
    shutil.rmtree(scratch, ignore_errors=True)  # of a run that was killed
    try:
        scratch.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"cannot write {scratch}: {error.strerror or error}") from error
    try:
        stores, left_out = _cut(images, model, views, 2 * half + 1, scratch, progress)
        matching = _Matching(model, views, stores, search, threads)
        with progress.stage("matching tie points", len(stores), "photograph") as steps:
            for reference in stores:
                matching.match(reference)
                steps.advance()
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return matching.tie_points(left_out)


def _search_radius(model: SparseModel) -> int:
    known = model.errors[model.errors >= 0]
    error = float(np.mean(known)) if known.size else 1.0
    return int(np.clip(math.ceil(_SEARCH * error), _LEAST_SEARCH, _MOST_SEARCH))


def _cut(
    images: Path, model: SparseModel, views: Views, side: int, folder: Path, progress: Progress
) -> tuple[dict[int, PatchStore], list[LeftOut]]:
    """The squares around the views of each photograph, in the order of the views."""
    stores: dict[int, PatchStore] = {}
    left_out: list[LeftOut] = []
    with progress.stage("cutting tie points", len(model.images), "photograph") as steps:
        for index, image in enumerate(model.images):
            camera = model.camera_of(image)
            size = (camera.width, camera.height)
            xy = views.xy[views.of_image(index)]
            try:
                stores[index] = cut_patches(
                    images / image.name, size, xy, side, folder / f"{index:06}"
                )
            except InputError as error:
                leave_out(image.name, str(error), left_out, progress)
            steps.advance()
    return stores, left_out


class _Matching:
    """Of each view: what became of it, and where the point is."""

    def __init__(
        self,
        model: SparseModel,
        views: Views,
        stores: dict[int, PatchStore],
        search: int,
        threads: int,
    ) -> None:
        self._model, self._views, self._stores = model, views, stores
        grey_level = max((store.grey_level for store in stores.values()), default=1)
        self._options = _core.MatchingOptions(_RADIUS, search, grey_level)
        self._threads = threads
        count = len(views.image)
        self._status = np.full(count, -1, np.int8)  # not searched
        self._xy = np.zeros((count, 2))
        self._covariance = np.zeros((count, 2, 2))

    def match(self, reference: int) -> None:
        """Searches all other photographs for the points whose reference this photograph is."""
        views, store = self._views, self._stores[reference]
        first = int(views.starts[reference])
        rows = first + np.flatnonzero(views.is_reference[views.of_image(reference)])
        others = views.others(rows)  # sorted by photograph
        others = others[np.isin(views.image[others], list(self._stores))]
        if not others.size:
            return
        starts = store.indices(rows - first, views.xy[rows])
        centres = np.empty((rows.size, 2), np.int32)
        for batch in _batches(rows.size):
            centres[batch] = _core.best_textured(
                store.read(rows[batch] - first),
                starts[batch],
                _TEXTURE_RADIUS,
                _RADIUS,
                self._threads,
            )
        self._xy[rows] = store.origins[rows - first] + centres + 0.5
        planes = LocalPlanes(self._model, reference, views.point[rows], self._xy[rows])
        place = np.full(len(self._model.points), -1)
        place[views.point[rows]] = np.arange(rows.size)
        which = place[views.point[others]]
        for batch in _batches(others.size):
            self._match_batch(store, rows - first, centres, planes, others[batch], which[batch])
        # The reference is exact by definition; its noise is part of every match, so all share it.
        found = self._status[others] == MATCHED
        sums = np.zeros((rows.size, 2, 2))
        np.add.at(sums, which[found], self._covariance[others[found]])
        counts = np.bincount(which[found], minlength=rows.size)
        seen = counts > 0
        self._covariance[rows[seen]] = sums[seen] / counts[seen, None, None]
        self._status[rows[seen]] = MATCHED

    def _match_batch(
        self,
        store: PatchStore,
        of_store: Ints,
        centres: NDArray[np.int32],
        planes: LocalPlanes,
        others: Ints,
        which: Ints,
    ) -> None:
        """Matches a batch; what finds nothing alike with the slope of its surroundings is tried again with
        that of the whole photograph."""
        remaining = np.arange(others.size)
        references = store.read(of_store[which])
        targets = self._read(others)
        whites = np.column_stack([np.full(others.size, store.white), self._whites(others)])
        whites = np.ascontiguousarray(np.round(_SATURATED * whites), np.int32)
        for slopes in planes.local, planes.common:
            predicted, affines = self._predict(planes, slopes, others[remaining], which[remaining])
            corners = self._corners(others[remaining])
            status, position, _, covariance, _ = _core.match_patches(
                references[remaining],
                centres[which[remaining]],
                targets[remaining],
                predicted - corners - 0.5,
                affines,
                whites[remaining],
                self._threads,
                self._options,
            )
            rows = others[remaining]
            self._status[rows] = status
            self._xy[rows] = corners + position + 0.5
            self._covariance[rows] = covariance + _FLOOR**2 * np.eye(2)
            remaining = remaining[status != MATCHED]

    def _predict(
        self, planes: LocalPlanes, slopes: Floats, others: Ints, which: Ints
    ) -> tuple[Floats, Floats]:
        predicted, affines = np.empty((others.size, 2)), np.empty((others.size, 2, 2))
        for target, at in _by_image(self._views.image[others]):
            predicted[at], affines[at] = planes.seen_from(target, slopes, which[at])
        return predicted, affines

    def _read(self, others: Ints) -> NDArray[np.uint16]:
        parts = [
            self._stores[target].read(others[at] - self._views.starts[target])
            for target, at in _by_image(self._views.image[others])
        ]
        return np.concatenate(parts)

    def _corners(self, others: Ints) -> Floats:
        corners = np.empty((others.size, 2))
        for target, at in _by_image(self._views.image[others]):
            corners[at] = self._stores[target].origins[others[at] - self._views.starts[target]]
        return corners

    def _whites(self, others: Ints) -> Ints:
        whites = np.empty(others.size, np.int64)
        for target, at in _by_image(self._views.image[others]):
            whites[at] = self._stores[target].white
        return whites

    def tie_points(self, left_out: list[LeftOut]) -> TiePoints:
        views = self._views
        searched = (self._status >= 0) & ~views.is_reference
        status = np.zeros((len(self._model.images), len(STATUS)), np.int64)
        np.add.at(status, (views.image[searched], self._status[searched]), 1)
        kept = np.flatnonzero(self._status == MATCHED)
        return TiePoints(
            views.image[kept],
            views.point[kept],
            self._xy[kept],
            self._covariance[kept],
            status,
            tuple(left_out),
        )


def _batches(count: int) -> Iterator[slice]:
    return (slice(first, min(count, first + _BATCH)) for first in range(0, count, _BATCH))


def _by_image(image: Ints) -> Iterator[tuple[int, slice]]:
    """The runs of equal values of a sorted array."""
    ends = [*(np.flatnonzero(np.diff(image)) + 1).tolist(), len(image)]
    first = 0
    for end in ends:
        if end > first:
            yield int(image[first]), slice(first, end)
        first = end
