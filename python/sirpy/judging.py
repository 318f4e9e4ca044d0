"""What the sources say of depths that were found without them, by a network for example.

The surface around every pixel gives its normal; then PatchMatch judges the planes as they are, without a sweep: how
alike the sources look there, how many see it, and how many have found the same depth.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sirpy import _core
from sirpy.filtering import JUDGED_CONFIDENCE
from sirpy.patch_match import PatchMatch
from sirpy.rectangle import Rectangle
from sirpy.stereo_backend import (
    DepthMap,
    DepthRange,
    FloatMap,
    Plane,
    Prior,
    StereoBackend,
    StereoOptions,
    View,
)
from sirpy.workspace import Pass


class Judge(StereoBackend):
    """The last pass after backends that do not look at the depths of the sources."""

    kind: Pass = "geometric"
    planes: tuple[Plane, ...] = ()
    title: str = "stereo, judged"
    cpu_us: tuple[float, float] = (1.5, 0.3)
    confidence: npt.NDArray[np.float64] = JUDGED_CONFIDENCE

    def __init__(self, options: StereoOptions) -> None:
        self._patch_match = PatchMatch(0, "geometric", 0, options=options)

    @property
    def margin(self) -> int:
        return self._patch_match.margin + _core.NORMAL_REACH

    def memory(self, reference_pixels: int, source_pixels: int) -> int:
        return self._patch_match.memory(reference_pixels, source_pixels)

    def estimate(
        self, reference: View, sources: Sequence[View], depth_range: DepthRange, prior: Prior
    ) -> DepthMap:
        assert prior.maps is not None  # it follows another pass
        window = reference.window
        depth = prior.maps.read(reference.name, window, "depth")
        start = _core.StartMaps(
            level=0,
            x0=window.x0,
            y0=window.y0,
            depth=depth,
            normal=normals(depth, reference.camera.intrinsics, window),
            views=np.zeros(depth.shape, np.uint32),  # those that it looks best in
        )
        return self._patch_match.run(reference, sources, depth_range.field, prior.points, start)


def normals(depth: FloatMap, intrinsics: npt.NDArray[np.float64], window: Rectangle) -> FloatMap:
    """Normals (3, height, width), camera frame, towards the camera, of a depth map; 0 where it has none.

    Of planes that fit 5 x 5 pixels, at an edge on the pixel's own side (cpp/src/depth_normals.h).

    Args:
        depth: (height, width), 0 where there is none.
        intrinsics: (3, 3) of the whole image.
        window: of the map, in pixels of the image.
    """
    padded = np.pad(depth, _core.NORMAL_REACH)  # what lies outside is missing
    return _core.normals_of_depth(padded, intrinsics=intrinsics, x0=window.x0, y0=window.y0)
