"""PatchMatch (cpp/src/patch_match_sir.h) as stereo backends: a list of passes from coarse to native.

Whole photographs decimated, then sub-images at finer and finer levels, each pass from the planes of the one before;
in the geometric passes the depths that the sources have found have their say.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.settling import settle
from sirpy.stereo_backend import (
    DepthMap,
    DepthRange,
    Plane,
    Prior,
    Setup,
    StereoBackend,
    StereoOptions,
    View,
)
from sirpy.stereo_passes import PassMaps
from sirpy.view_fields import ViewField
from sirpy.workspace import Pass

_LEAST_SIDE = 2  # pixels of a source's window: what is narrower holds no patch
# What is held while the core works, for each pixel of the window (grey 1; of the pass before depth 4, normal 12,
# sources 4, standard deviation 4, level 1) and of each source window (grey 1; depth 4, its standard deviation 4, and
# the inverse of both, 8).
_GIVEN = 26, 17
_SWEEP_US = 0.72, 0.27  # CPU microseconds of a sweep for a pixel, and for each of its sources


@dataclass(frozen=True)
class PatchMatch(StereoBackend):
    """One pass at one level; with 0 iterations it judges the planes of the pass before."""

    level: int = 0
    kind: Pass = "photometric"
    iterations: int = 2  # sweeps
    offers: int = 8  # planes of neighbours that a pixel tries
    largest_step: float = 2.0  # pixels of motion in the sources, of the first refinement
    complete: bool = False  # weak texture takes the planes around it
    everywhere: bool = False  # depths at random over the whole range are tried too
    options: StereoOptions = field(default_factory=StereoOptions)

    @property
    def planes(self) -> tuple[Plane, ...]:
        known: tuple[Plane, ...] = ("depth", "normal", "views", "sigma", "level")
        return (*known, "cost", "texture", "counts") if self.kind == "geometric" else known

    @property
    def cpu_us(self) -> tuple[float, float]:
        share = max(self.iterations, 1) / 4**self.level
        return share * _SWEEP_US[0], share * _SWEEP_US[1]

    @property
    def margin(self) -> int:
        completion = int(_core.PLANAR_COMPLETION_MARGIN) if self.complete else 0
        return int(_core.patch_match_margin(self.iterations)) + completion

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        reference, source, at_end = _core.patch_match_bytes_per_pixel()
        given = _GIVEN[0] * reference_pixels + _GIVEN[1] * source_pixels
        return given + max(
            reference * reference_pixels + source * source_pixels, at_end * reference_pixels
        )

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        start = (
            prior.maps.start(reference.name, reference.window, self.level) if prior.maps else None
        )
        found = self.run(reference, sources, depth_range.field, prior.points, start)
        if self.complete and sources:
            self._complete(reference, sources, depth_range.field, found)
        if self.kind == "geometric" and isinstance(prior.coarser, PassMaps):
            settle(
                found,
                reference.camera,
                reference.window,
                self.level,
                prior.coarser,
                self.options,
            )
        return found

    def run(
        self,
        reference: View,
        sources: Sequence[View],
        blocks: ViewField,
        points: npt.NDArray[np.float64],
        start: _core.StartMaps | None,
    ) -> DepthMap:
        """From `start` or, where it is None, from sparse points and at random."""
        options = _core.PatchMatchOptions()
        options.iterations = self.iterations
        options.offers = self.offers
        options.largest_step = self.largest_step
        options.top_views = self.options.top_views
        options.everywhere = self.everywhere
        if reference.noise is not None:
            options.noise = reference.noise.tolist()
        options.threads = self.options.threads
        # The random numbers of an image depend on its name, not on which others there are.
        options.seed = zlib.crc32(f"{self.options.seed} {self.name} {reference.name}".encode())
        table: list[_core.ViewWindow | None] = [None] * len(blocks.sources)
        for source in sources:
            if min(source.window.width, source.window.height) >= _LEAST_SIDE:
                table[source.index] = _view_window(source)
        found = _core.patch_match(
            reference=_view_window(reference),
            sources=table,
            block_side=blocks.side,
            allowed=blocks.allowed,
            min_depth=blocks.min_depth,
            max_depth=blocks.max_depth,
            points=points if start is None or self.everywhere else np.empty((0, 3)),
            start=start,
            options=options,
        )
        return DepthMap(**found)

    def _complete(
        self, reference: View, sources: Sequence[View], field: ViewField, found: DepthMap
    ) -> None:
        """Gives weak texture the planes around it (cpp/src/patch_match/planar_completion.h)."""
        options = _core.PlanarCompletionOptions()
        options.threads = self.options.threads
        options.min_consistent = min(options.min_consistent, len(sources))
        assert found.normal is not None and found.views is not None
        assert found.texture is not None and found.num_consistent is not None
        found.depth, found.normal, _ = _core.complete_planes(
            level=self.level,
            x0=reference.window.x0,
            y0=reference.window.y0,
            intrinsics=reference.camera.intrinsics,
            grey=reference.grey,
            depth=found.depth,
            normal=found.normal,
            views=found.views,
            texture=found.texture,
            num_consistent=found.num_consistent,
            source_centres=reference.camera.in_camera(
                np.stack([source.camera.centre for source in sources])
            ),
            options=options,
        )


def patch_match(setup: Setup) -> list[StereoBackend]:
    """Coarse to native. What the whole photograph tells is made sure of by its sources at once; the
    levels between halve the pixel."""
    return list(passes(setup.coarsest, setup.options, setup.top))


def passes(coarsest: int, options: StereoOptions, top: int = 0) -> list[PatchMatch]:
    """As `patch_match`."""
    native, geometric = options.native_iterations, options.geometric_iterations
    found = []
    for level in range(max(top, coarsest), coarsest - 1, -1):  # whole photographs, everywhere
        found += [
            PatchMatch(level, "photometric", 4, largest_step=8, everywhere=True, options=options),
            PatchMatch(level, "geometric", 2, complete=True, options=options),
        ]
    for level in range(coarsest - 1, 0, -1):
        found += [
            PatchMatch(level, "photometric", 2, options=options),
            PatchMatch(level, "geometric", 1, complete=True, options=options),
        ]
    return [
        *found,
        PatchMatch(0, "photometric", native, offers=5, options=options),
        PatchMatch(0, "geometric", geometric, offers=5, complete=True, options=options),
    ]


def _view_window(view: View) -> _core.ViewWindow:
    inverse = deviation = None
    if view.depth is not None:
        inverse = np.zeros_like(view.depth)
        np.divide(1, view.depth, out=inverse, where=view.depth > 0)
        if view.sigma is not None:
            deviation = view.sigma * inverse * inverse
    return _core.ViewWindow(
        intrinsics=view.camera.intrinsics,
        cam_from_world=view.camera.cam_from_world,
        level=view.level,
        x0=view.window.x0,
        y0=view.window.y0,
        grey=view.grey,
        inverse_depth=inverse,
        deviation=deviation,
    )
