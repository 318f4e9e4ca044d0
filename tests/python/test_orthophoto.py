"""The orthophoto: colours where they belong, also beside a house that hides the ground."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from cloud_scenes import UTM
from engine_scenes import Notes
from house_scene import BLUE, GSD, HALF, HEIGHT, RED, ROOF, ground_colour, photographed_house
from sirpy import best_views
from sirpy import orthophoto as ortho_module
from sirpy import surface_model as surface_module
from sirpy.cloud import Cloud
from sirpy.errors import InputError
from sirpy.frame import Frame
from sirpy.orthophoto import orthophoto
from sirpy.surface_model import surface_model
from sirpy.workspace import Workspace

Floats = npt.NDArray[np.float64]

# Two photographs on the western side: some ground east of the house is seen by neither.
WEST = ((-2.0, 0.0), (-12.0, 0.5))
AROUND = ((-12.0, 0.0), (0.0, -1.0), (12.0, 0.0))


def made(
    monkeypatch: pytest.MonkeyPatch, workspace: Workspace, cloud: Cloud, **options: Any
) -> tuple[npt.NDArray[np.uint8], Floats]:
    """(colours (n, 4), centres (n, 2) from the frame's origin, turned and scaled back) of all cells."""
    monkeypatch.setattr(ortho_module, "open_cloud", lambda _: cloud)
    with rasterio.open(orthophoto(workspace, **options)) as file:
        colours = file.read().reshape(4, -1).T
        (left, top), side = (file.bounds.left, file.bounds.top), file.res[0]
        x, y = np.meshgrid(
            left + side * (np.arange(file.width) + 0.5), top - side * (np.arange(file.height) + 0.5)
        )
    world = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, cloud.frame.translation[2])])
    return colours, cloud.frame.model(world)[:, :2]


def beyond_wall(places: Floats) -> Floats:
    """How far places are outside the house, as the larger of x and y."""
    return np.abs(places).max(axis=1) - HALF


def is_ground(colours: npt.NDArray[np.uint8], places: Floats) -> npt.NDArray[np.bool_]:
    """Which colours are those of the ground at their place."""
    near: npt.NDArray[np.bool_] = np.abs(colours[:, :3] - ground_colour(places)).max(axis=1) <= 2.5
    return near


@pytest.mark.parametrize("frame", [Frame(), UTM], ids=["local", "utm"])
def test_colours_are_where_they_belong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frame: Frame
) -> None:
    workspace, cloud = photographed_house(tmp_path, AROUND, frame)
    colours, places = made(monkeypatch, workspace, cloud, fill=3.0 * frame.scale)
    seen, out = colours[:, 3] == 255, beyond_wall(places)
    assert set(np.unique(colours[:, 3])) <= {0, 255}
    roof, ground = seen & (out < -GSD), seen & (out > 2 * GSD)
    assert (np.abs(colours[roof, :3] - np.array(RED)).max(axis=1) <= 2).all()
    assert is_ground(colours[ground], places[ground]).all()
    near = np.abs(places).max(axis=1) < 15
    assert seen[near].mean() > 0.95
    # The walls are not seen straight from above.
    assert (np.abs(colours[seen, :3] - np.array(BLUE)).max(axis=1) < 30).sum() == 0


def test_hidden_ground_is_transparent_and_not_roof(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the heights filled, both photographs show the roof where this ground would be."""
    workspace, cloud = photographed_house(tmp_path, WEST)
    colours, places = made(monkeypatch, workspace, cloud, fill=3.0)
    shadow = ROOF / (HEIGHT - ROOF) * (HALF + 2)  # of the house, seen from the nearer photograph
    x, y = places.T
    east = (np.abs(y) < 4) & (x > HALF + GSD)
    hidden = east & (x < HALF + shadow - GSD)
    beyond = east & (x > HALF + shadow + 3 * GSD) & (x < 12)
    assert hidden.sum() > 50 and beyond.sum() > 500
    assert (colours[hidden, 3] == 0).all()
    assert (colours[beyond, 3] == 255).all()
    assert is_ground(colours[beyond], places[beyond]).all()


def test_the_most_nadir_photograph_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One photograph is made brighter: its part ends half-way between the two, and fades."""
    workspace, cloud = photographed_house(tmp_path, ((-12.0, 0.0), (12.0, 0.0)))
    original = best_views.read_window

    def brighter(workspace: Workspace, name: str, *rest: Any) -> Any:
        return original(workspace, name, *rest) + np.uint8(40 if name == "2.png" else 0)

    monkeypatch.setattr(best_views, "read_window", brighter)
    colours, places = made(monkeypatch, workspace, cloud)
    seen = (colours[:, 3] == 255) & (beyond_wall(places) > 2)
    excess = colours[seen, 0] - ground_colour(places[seen])[:, 0]
    x = places[seen, 0]
    assert (np.abs(excess[x < -1.5]) < 2.5).all()
    assert (np.abs(excess[x > 1.5] - 40) < 2.5).all()
    between = np.abs(x) < 0.25
    assert between.sum() > 20
    assert ((excess[between] > 5) & (excess[between] < 35)).mean() > 0.8


def test_the_file_does_not_depend_on_blocks_or_the_grid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace, cloud = photographed_house(tmp_path, AROUND, UTM)
    files = []
    for side in (512, 37):
        monkeypatch.setattr(surface_module, "BLOCK", side)
        monkeypatch.setattr(ortho_module, "BLOCK", side)
        made(monkeypatch, workspace, cloud, fill=2.0)
        files.append(workspace.orthophoto.read_bytes())
    assert files[0] == files[1]


def test_it_lies_cell_on_cell_on_the_surface_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace, cloud = photographed_house(tmp_path, AROUND, UTM)
    made(monkeypatch, workspace, cloud, tiles="20")
    monkeypatch.setattr(surface_module, "open_cloud", lambda _: cloud)
    with (
        rasterio.open(surface_model(workspace)) as heights,
        rasterio.open(workspace.orthophoto) as colours,
    ):
        assert heights.res == colours.res
        assert heights.crs == colours.crs
        apart = (colours.bounds.left - heights.bounds.left) / heights.res[0]
        assert apart == pytest.approx(round(apart), abs=1e-6)
        x, y = heights.xy(heights.height // 2, heights.width // 2)
        height, colour = (next(iter(file.sample([(x, y)]))) for file in (heights, colours))
        assert height[0] > 100 and colour[3] == 255
    assert list(workspace.tile("x", "ortho.tif").parent.glob("*.ortho.tif"))


def test_coarse_cells_are_means(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkerboard of pixels is grey, not one of its colours."""
    workspace, cloud = photographed_house(tmp_path, ((0.0, 0.0),))

    def checkerboard(_: Any, __: str, window: Any, ___: str) -> Any:
        y, x = np.mgrid[window.y0 : window.y1, window.x0 : window.x1]
        return np.repeat((((x + y) % 2) * 200)[..., None].astype(np.uint8), 3, axis=-1)

    monkeypatch.setattr(best_views, "read_window", checkerboard)
    colours, places = made(monkeypatch, workspace, cloud, resolution=8 * GSD)
    inner = (colours[:, 3] == 255) & (np.abs(places).max(axis=1) < 20)
    assert inner.sum() > 100
    assert np.abs(colours[inner, :3].astype(float) - 100).max() < 25


def test_without_a_depth_map_other_photographs_show_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing would say what hides the ground in it."""
    workspace, cloud = photographed_house(tmp_path, AROUND)
    whole, _ = made(monkeypatch, workspace, cloud)
    middle = [sub for native, sub in workspace.sub_images() if native.name == "2.png"]
    for sub_image in middle:
        workspace.depth_map(sub_image, "geometric").unlink()
    notes = Notes()
    colours, places = made(monkeypatch, workspace, cloud, progress=notes)
    assert any("without sub-images that have no sound depth map: 2_r00" in n for n in notes.notes)
    seen = (colours[:, 3] == 255) & (beyond_wall(places) > 2 * GSD)
    assert is_ground(colours[seen], places[seen]).all()
    assert 0.8 < seen.sum() / (whole[:, 3] == 255).sum() < 1
    for _, sub_image in workspace.sub_images():
        workspace.depth_map(sub_image, "geometric").unlink(missing_ok=True)
    workspace.orthophoto.unlink()
    with pytest.raises(InputError, match="no depth map that can be used"):
        made(monkeypatch, workspace, cloud)
    assert not workspace.orthophoto.exists()
    assert not list(workspace.folder.glob(".*"))


def test_what_is_masked_is_not_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace, cloud = photographed_house(tmp_path, ((0.0, 0.0),))

    def western(_: Any, __: str, window: Any) -> npt.NDArray[np.bool_]:
        columns = np.arange(window.x0, window.x1)
        return np.broadcast_to(columns < 160, (window.height, window.width))

    monkeypatch.setattr(best_views, "read_mask_window", western)
    notes = Notes()
    colours, places = made(monkeypatch, workspace, cloud, progress=notes)
    assert places[colours[:, 3] == 255, 0].min() > -GSD
    assert "with a colour" in notes.notes[-1]
