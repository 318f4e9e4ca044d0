"""The top of a tower that is nearly two thirds as tall as the flight is high."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tall
from sirpy import _core, reconstruct
from sirpy.flight import GSD, flying_height
from sirpy.ply import read_vertices

SIZE = (320, 240)
TOWER = (20.0, 17.0)  # of the row that `tall` has
HALF = 2.5  # of the tower, m, its walls not along the axes


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four photographs, a tower in the middle."""
    folder = tmp_path_factory.mktemp("tower")
    return tall.render(folder / "scene", image_count=4, size=SIZE, middle=TOWER)


@pytest.fixture(scope="module")
def roof(scene: Path) -> np.ndarray:
    """Places of the surface, (n, 3), in the topmost two metres of the tower."""
    with np.load(scene / "places.npz") as file:
        places = file["places"]
    places = places[np.abs(places[:, :2] - TOWER).max(axis=1) < HALF]
    return np.ascontiguousarray(places[places[:, 2] > places[:, 2].max() - 2])


@pytest.mark.parametrize("model", ["sparse", "sparse_ground"])
def test_the_top_of_a_tower_is_found(
    scene: Path, roof: np.ndarray, tmp_path: Path, model: str
) -> None:
    assert len(roof) > 100
    assert tall.heights(roof).min() > 0.5 * flying_height(SIZE)
    made = reconstruct(scene / "images", tmp_path, model=scene / model, memory=1_000_000_000)
    vertices = read_vertices(made.workspace.fused)
    cloud = np.column_stack([vertices[axis].astype(np.float64) for axis in "xyz"])
    distance = _core.nearest_distances(roof, cloud, 2 * GSD)
    assert np.isfinite(distance).mean() > 0.8
