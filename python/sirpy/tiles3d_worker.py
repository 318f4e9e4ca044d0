"""The process that runs py3dtiles: `python -m sirpy.tiles3d_worker POINTS.las FOLDER`.

One worker and a fixed seed, so that the same points give the same tiles. The points come uncompressed: lazrs has
threads, which py3dtiles would fork.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

_POINTS_IN_PROGRESS = 4_000_000  # read and not yet in a tile; what memory goes with
_CACHE = 200  # MB of finished tiles, compressed; the rest waits on disk


def main(points: Path, folder: Path) -> None:
    import numpy as np
    from py3dtiles.convert import Converter
    from py3dtiles.tilers.point.point_tiler import PointTiler

    class BoundedTiler(PointTiler):  # type: ignore[misc, unused-ignore]
        def initialize(self, *arguments: Any) -> None:
            super().initialize(*arguments)
            self.state.max_point_in_progress = _POINTS_IN_PROGRESS

    np.random.seed(0)  # the first look at the whole is a random choice
    # Colours fill 16 bits; without a scale py3dtiles would guess from the first points.
    tiler = BoundedTiler(cache_size=_CACHE, number_of_jobs=1, color_scale=1.0)
    Converter([tiler], jobs=1, cache_size=_CACHE, use_process_pool=False).convert(points, folder)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
