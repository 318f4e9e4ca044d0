"""What a photograph carries: its noise, and the finest detail that is more than noise.

Photographs carry less than their pixels say: sensors have noise, lenses and demosaicing blur, JPEG drops weak detail
and leaves blocks. Both are estimated from windows spread over the photograph, in grey levels of 8 bit; pixels of
level l are means of 2^l x 2^l native ones. Brightness is in 16 bins of 16 grey levels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sirpy.noise import Floats, Grey, measure_noise
from sirpy.rectangle import Rectangle
from sirpy.resolution import measure_resolution

WINDOW = 512  # side in pixels
_HIDING = 0.01  # squared grey levels, times the eighth power of what is resolved
_LEAST_NATIVE, _LEAST = 2.0, 1 / 12  # squared grey levels: of every camera, and of rounding
_MOST_WINDOWS = 24  # memory and time do not grow with the photograph


@dataclass(frozen=True)
class Detail:
    """What a photograph carries."""

    noise: Floats
    """Variance of the noise in squared grey levels, (8, 16), by level and brightness."""
    resolution: float
    """Native pixels, at least 1: the finest detail that is more than noise."""

    @property
    def noise_level(self) -> float:
        """Standard deviation of the noise of native pixels, in grey levels: median over brightness."""
        return float(np.sqrt(np.median(self.noise[0])))

    @property
    def sure_noise(self) -> Floats:
        """As `noise`, what is noise for certain: where no place is quiet, `noise` holds texture too.

        No more than fits what the photograph resolves: where the pixels of a level are finer, noise hides the
        detail that they could show.
        """
        steps = self.resolution / 2.0 ** np.arange(len(self.noise))
        sure = np.minimum(self.noise, _HIDING * steps[:, None] ** 8)
        floor = np.maximum(_LEAST_NATIVE / 4.0 ** np.arange(len(self.noise)), _LEAST)
        found: Floats = np.maximum(sure, floor[:, None]).astype(np.float32)
        return found


def measure_detail(read: Callable[[Rectangle], Grey], width: int, height: int) -> Detail:
    """Estimates noise and resolution of a photograph of `width` x `height` pixels.

    Args:
        read: gives the grey levels, (height, width), of a rectangle of native pixels; it is asked for those of
            `sample_windows`, in that order.
    """
    windows = [np.ascontiguousarray(read(one)) for one in sample_windows(width, height)]
    noise = measure_noise(windows)
    return Detail(noise, measure_resolution(windows, noise))


def sample_windows(width: int, height: int) -> list[Rectangle]:
    """At most 24 squares of 512 pixels, evenly spread, row by row; all of a smaller side."""
    even = round((_MOST_WINDOWS * width / height) ** 0.5)
    across = max(1, min(even, _MOST_WINDOWS, width // WINDOW))
    down = max(1, min(_MOST_WINDOWS // across, height // WINDOW))
    wide, high = min(WINDOW, width), min(WINDOW, height)
    # Multiples of 8: where blocks of JPEG begin.
    xs = [(2 * i + 1) * width // (2 * across) - wide // 2 & ~7 for i in range(across)]
    ys = [(2 * i + 1) * height // (2 * down) - high // 2 & ~7 for i in range(down)]
    return [Rectangle(x, y, wide, high) for y in ys for x in xs]
