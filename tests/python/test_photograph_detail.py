"""Photographs on disk are measured as their pixels are, and what is said of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from sirpy.detail import Detail
from sirpy.photograph_detail import photograph_detail, photograph_details, spoken_details

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


def write(path: Path, grey: np.ndarray) -> Path:
    height, width = grey.shape
    profile = {"width": width, "height": height, "count": 1, "dtype": grey.dtype}
    with rasterio.open(path, "w", **profile) as file:
        file.write(grey, 1)
    return path


def noisy(width: int, height: int) -> np.ndarray:
    """Grey of 120 with noise of variance 9."""
    return 120 + 3 * np.random.default_rng(1).normal(size=(height, width))


@pytest.mark.parametrize("size", [(1200, 700), (900, 300)])
def test_original_photographs_of_any_depth(tmp_path: Path, size: tuple[int, int]) -> None:
    grey = noisy(*size).round()
    grey[: size[1] // 4, :200] = 250
    white = photograph_detail(write(tmp_path / "a.png", grey.astype(np.uint8))).noise[0, 7]
    assert white == pytest.approx(9, rel=0.25)
    # Of 12 bits in 16, the brightest is white.
    deep = (grey * 16).astype(np.uint16)
    deep[: size[1] // 8, :200] = 4095
    of_deep = photograph_detail(write(tmp_path / "b.tif", deep)).noise[0, 7]
    assert of_deep == pytest.approx(9, rel=0.25)


def test_few_are_measured_and_those_that_cannot_be_read_are_left_out(tmp_path: Path) -> None:
    names = [f"{index:03d}.png" for index in range(100)]
    for name in names[:-1]:
        write(tmp_path / name, noisy(64, 48).astype(np.uint8))
    found = photograph_details(tmp_path, names)
    assert len(found) == 23
    assert list(found)[:2] == ["000.png", "004.png"]


def test_what_is_said() -> None:
    noise = np.full((8, 16), 4.0, np.float32)
    details = {
        name: Detail(noise, resolution)
        for name, resolution in (("a", 1.2), ("b", 3.62), ("c", 1.9), ("d", 2.1), ("e", 1.0))
    }
    assert spoken_details(details, 5) == [
        "native pixels carry detail in 3 of 5 photographs; 2 resolve no less than 2 pixels: "
        "decimating these by 2 would lose little",
        "b resolves 3.6 pixels; noise 2.0 grey levels",
        "d resolves 2.1 pixels; noise 2.0 grey levels",
        "c resolves 1.9 pixels; noise 2.0 grey levels",
    ]
    sharp = {"a": details["a"]}
    (said, _) = spoken_details(sharp, 2000)
    assert said == "native pixels carry detail in 1 of 1 photographs measured, of 2,000"
    assert spoken_details({}, 3) == []
