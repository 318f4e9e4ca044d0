"""The surface model: heights of shapes that are known exactly."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from cloud_scenes import UTM, Floats, cloud_of, scattered
from engine_scenes import Notes
from sirpy import surface_model as module
from sirpy.block_store import BlockStore
from sirpy.cloud import Cloud
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.lattice import Lattice
from sirpy.progress import Progress
from sirpy.resources import Meter
from sirpy.surface_model import find_heights, surface_model
from sirpy.workspace import Workspace

GSD = 0.1
ROOF, NORTH = 6.0, np.array([0.0, 1.0, 0.0])


def heights_of(
    folder: Path, cloud: Cloud, cell: float = GSD, fill: float | None = None
) -> tuple[npt.NDArray[np.float64], Floats]:
    """(heights (n,), centres (n, 2)) of all cells of a cloud, from the frame's origin."""
    store = find_heights(cloud, Lattice(cell), fill, folder, Progress())
    centres = store.lattice.centres(store.window).reshape(-1, 2) - cloud.frame.translation[:2]
    heights = store.read(store.window)[0].astype(np.float64) - cloud.frame.translation[2]
    return heights.ravel(), centres


def on_ground(places: Floats, height: Any = 0.0) -> Floats:
    return np.column_stack([places, np.broadcast_to(height, len(places))])


def house(gap: float = 0.0, walls: int = 0) -> tuple[Floats, Floats]:
    """(places, normals) of a flat roof, 0 <= x, y < 4, on ground that nothing is known of within `gap` of it; and
    points of its walls."""
    roof = on_ground(scattered((0, 0), (4, 4), GSD), ROOF)
    ground = on_ground(scattered((-4, -4), (8, 8), GSD, seed=1))
    beside = np.abs(ground[:, :2] - 2).max(axis=1)
    ground = ground[beside > 2 + gap]
    random = np.random.default_rng(2)
    along = random.uniform(0, 4, walls)
    wall = np.column_stack([along, np.full(walls, 4.0), random.uniform(0, ROOF, walls)])
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(roof) + len(ground), 3))
    return np.vstack([roof, ground, wall]), np.vstack([up, np.broadcast_to(NORTH, wall.shape)])


@pytest.mark.parametrize("frame", [Frame(), UTM], ids=["local", "utm"])
@pytest.mark.parametrize("cell", [GSD, 0.25, 1.0])
def test_a_slope_is_exact(tmp_path: Path, frame: Frame, cell: float) -> None:
    xy = scattered((-10, -10), (10, 10), GSD)
    normal = np.array([-0.5, 0.3, 1.0]) / np.linalg.norm([-0.5, 0.3, 1.0])
    slope = on_ground(xy, 0.5 * xy[:, 0] - 0.3 * xy[:, 1]) + frame.translation
    cloud = cloud_of(tmp_path / "points.npy", slope, tuple(normal), GSD, frame)
    heights, centres = heights_of(tmp_path, cloud, cell)
    inner = np.abs(centres).max(axis=1) < 10 - cell
    inner &= ~np.isnan(heights)
    assert inner.sum() > 0.999 * ((20 - 2 * cell) / cell) ** 2
    exact = 0.5 * centres[:, 0] - 0.3 * centres[:, 1]
    np.testing.assert_allclose(heights[inner], exact[inner], atol=2e-4 if frame.crs else 1e-5)


@pytest.mark.parametrize("walls", [0, 20_000], ids=["roof", "roof and wall"])
def test_a_roof_ends_where_it_does(tmp_path: Path, walls: int) -> None:
    """No cell has a height between roof and ground, and the edge is right to a cell."""
    heights, centres = heights_of(tmp_path, cloud_of(tmp_path / "points.npy", *house(walls=walls)))
    known = ~np.isnan(heights)
    heights, centres = heights[known], centres[known]
    outside = np.abs(centres - 2).max(axis=1) - 2  # of the roof
    assert np.abs(heights[outside < 0] - ROOF).max() < 0.3
    assert np.abs(heights[outside > 1.01 * GSD]).max() < 1e-6
    is_roof, is_ground = np.abs(heights - ROOF) < 0.3, np.abs(heights) < 0.3
    assert (is_roof | is_ground).mean() > (0.999 if walls == 0 else 0.995)
    assert is_roof.sum() * GSD**2 == pytest.approx(16, rel=0.08)


def test_strays_do_not_show(tmp_path: Path) -> None:
    ground = on_ground(scattered((0, 0), (20, 20), GSD))
    random = np.random.default_rng(3)
    strays = np.column_stack(
        [random.uniform(0, 20, (len(ground) // 50, 2)), random.uniform(-9, 9, len(ground) // 50)]
    )
    cloud = cloud_of(tmp_path / "points.npy", np.vstack([ground, strays]))
    heights, centres = heights_of(tmp_path, cloud)
    heights = heights[np.abs(centres - 10).max(axis=1) < 10]
    known = ~np.isnan(heights)
    assert known.mean() > 0.99
    assert (np.abs(heights[known]) > GSD).mean() < 2e-3


def test_the_surer_and_finer_points_count_more(tmp_path: Path) -> None:
    fine, coarse = (scattered((0, 0), (10, 10), GSD, seed) for seed in (0, 1))
    places = np.vstack([on_ground(fine), on_ground(coarse, 0.1)])
    gsd = np.repeat([GSD, 3 * GSD], len(fine))
    heights, _ = heights_of(tmp_path, cloud_of(tmp_path / "points.npy", places, gsd=gsd))
    assert np.nanmedian(heights) < 0.03


def test_coarse_points_reach_farther(tmp_path: Path) -> None:
    """Ground that only far photographs see has no holes of the size of a cell."""
    fine, coarse = scattered((0, 0), (10, 10), GSD), scattered((10, 0), (14, 10), 2 * GSD)
    gsd = np.repeat([GSD, 2 * GSD], [len(fine), len(coarse)])
    places = on_ground(np.vstack([fine, coarse]))
    heights, centres = heights_of(tmp_path, cloud_of(tmp_path / "points.npy", places, gsd=gsd))
    coarse_cells = (centres[:, 0] > 10.5) & (centres[:, 0] < 13.5) & (np.abs(centres[:, 1] - 5) < 4)
    assert np.isnan(heights[coarse_cells]).mean() < 0.1


def test_gaps_are_filled_from_below_up_to_their_width(tmp_path: Path) -> None:
    points = cloud_of(tmp_path / "points.npy", *house(gap=0.6))
    bare, centres = heights_of(tmp_path / "bare", points)
    outside = np.abs(centres - 2).max(axis=1) - 2
    gap = (outside > GSD) & (outside < 0.5)
    assert np.isnan(bare[gap]).mean() > 0.95
    narrow, _ = heights_of(tmp_path / "narrow", points, fill=0.3)
    assert np.isnan(narrow[gap]).mean() > 0.8  # but for its corners
    filled, _ = heights_of(tmp_path / "filled", points, fill=0.8)
    # Hidden ground is ground; the roof does not grow by more than the cell that its edge is in.
    assert not np.isnan(filled[gap]).any()
    assert np.abs(filled[gap & ~np.isnan(filled)]).max() < 1e-6
    known = ~np.isnan(bare)
    np.testing.assert_array_equal(filled[known], bare[known])
    assert len(filled) == len(bare)  # nothing is added around the whole


def products(
    folder: Path, cloud: Cloud, monkeypatch: pytest.MonkeyPatch, **options: Any
) -> tuple[bytes, Notes]:
    notes = Notes()
    monkeypatch.setattr(module, "open_cloud", lambda _: cloud)
    path = surface_model(Workspace(folder), progress=notes, **options)
    return path.read_bytes(), notes


def test_the_file_does_not_depend_on_blocks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places, normals = house(gap=0.6, walls=3000)
    cloud = cloud_of(tmp_path / "points.npy", places + UTM.translation, normals, GSD, UTM)
    made = []
    for side in (512, 48, 7):
        monkeypatch.setattr(module, "BLOCK", side)
        made.append(products(tmp_path / f"{side}", cloud, monkeypatch, fill=0.9)[0])
    assert made[0] == made[1] == made[2]
    for name in ("512", "48"):
        assert [path.name for path in (tmp_path / name).iterdir()] == ["dsm.tif"]


def test_the_file_lies_where_the_cloud_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places, normals = house()
    cloud = cloud_of(tmp_path / "points.npy", places + UTM.translation, normals, 0.113, UTM)
    _, notes = products(tmp_path / "out", cloud, monkeypatch, tiles="5")
    with rasterio.open(tmp_path / "out" / "dsm.tif") as file:
        assert file.crs.to_epsg() == 32614
        assert file.res == (0.12, 0.12)  # a few digits, not below the GSD
        assert abs(file.bounds.left - (5e5 - 4)) < 0.25
        assert abs(file.bounds.top - (3.3e6 + 8)) < 0.25
        on_roof = next(iter(file.sample([(5e5 + 2, 3.3e6 + 2)])))
    assert on_roof[0] == pytest.approx(156, abs=1e-3)
    assert any("surface model: " in note and "of 0.12" in note for note in notes.notes)
    assert len(list((tmp_path / "out" / "tiles").glob("*.dsm.tif"))) >= 9


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"resolution": 0.0}, "--resolution 0 is not possible"),
        ({"resolution": 0.001}, "far below the GSD of the cloud, 0.1"),
        ({"resolution": 400.0}, "larger than the whole cloud"),
        ({"fill": 0.0}, "--fill 0 is not possible"),
        ({"fill": float("nan")}, "--fill nan is not possible"),
        ({"fill": 1e4}, "at most 500 cells, 50"),
        ({"tiles": "many"}, "--tiles many is no tiling"),
        ({"tiles": "quadkey:19"}, "needs a place on the Earth"),
    ],
)
def test_an_impossible_option_is_said_before_anything_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, Any], sentence: str
) -> None:
    cloud = cloud_of(tmp_path / "points.npy", on_ground(scattered((0, 0), (9, 9), GSD)))
    with pytest.raises(InputError, match=sentence):
        products(tmp_path / "out", cloud, monkeypatch, **options)
    assert not (tmp_path / "out").exists()


def test_clouds_of_nothing_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    none = cloud_of(tmp_path / "none.npy", np.empty((0, 3)))
    with pytest.raises(InputError, match="no points"):
        products(tmp_path / "out", none, monkeypatch)
    sparse = cloud_of(tmp_path / "few.npy", np.array([[0.0, 0, 0], [9, 9, 0]]))
    with pytest.raises(InputError, match=r"too sparse for cells of 0.1"):
        products(tmp_path / "out", sparse, monkeypatch)
    assert not (tmp_path / "out").exists()


def test_without_a_workspace_the_command_says_one_sentence(tmp_path: Path) -> None:
    for command in ("dsm", "ortho"):
        line = [sys.executable, "-m", "sirpy", command, str(tmp_path / "nothing")]
        done = subprocess.run(line, capture_output=True, text=True)
        assert done.returncode == 2
        assert len(done.stderr.splitlines()) == 1 and "nothing" in done.stderr


def test_memory_does_not_grow_with_the_cells(tmp_path: Path) -> None:
    """Points of a square of 20 m and of 60 m: nine times as many."""
    peaks = []
    for side in (20, 60):
        cloud = cloud_of(tmp_path / f"{side}.npy", on_ground(scattered((0, 0), (side, side), 0.05)))
        cloud.gsd = 0.05 / 4  # small blocks
        with Meter() as meter:
            store: BlockStore = find_heights(
                cloud, Lattice(0.05), None, tmp_path / f"blocks{side}", Progress()
            )
        assert store.cells > 0.98 * (side / 0.05) ** 2
        peaks.append(meter.peak_bytes or 0)
    assert peaks[1] < peaks[0] + 60e6
