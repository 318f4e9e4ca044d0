"""Small views of photographs with 16 bits; those of whole workspaces are in `test_html_report.py`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sirpy import overview
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.overview import Frame
from sirpy.rectangle import Grid
from sirpy.windows import read_window
from sub_image_scenes import HEIGHT, WIDTH, camera, model_of, noise, write_raster


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("format", ["png", "tif"])
def test_the_white_of_the_brightest_photograph_is_255(
    tmp_path: Path, format: str, channels: int
) -> None:
    names = ["bright.png", "dark.png"]
    for name, scale in zip(names, (16, 4), strict=True):  # 12 and 10 bits of 16
        pixels = noise((HEIGHT, WIDTH, channels)).astype(np.uint16) * scale
        write_raster(tmp_path / "photos" / name, pixels)
    workspace = cut(
        tmp_path / "photos",
        model_of(names, [camera("PINHOLE")] * 2),
        tmp_path / "out",
        identity="",
        grid=Grid(2, 2),
        pixels=PixelOptions(format=format),  # type: ignore[arg-type]
    )
    for native, brightest in zip(workspace.natives, (255, 64), strict=True):
        frame = Frame.of_native(native, WIDTH)
        view = overview.photograph(workspace, frame)
        np.testing.assert_array_equal(
            view, read_window(workspace, native.name, native.rectangle, "color")
        )
        assert view.max() == brightest
