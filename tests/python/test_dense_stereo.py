"""Stereo of cut photographs: the same whatever the grid, the threads and the sampling of the sources."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from sirpy import patch_match
from sirpy.cut_tasks import PixelOptions
from sirpy.cutting import cut
from sirpy.dense_stereo import stereo
from sirpy.fusion import fuse
from sirpy.layout import Region
from sirpy.native_scene import read_native_scene
from sirpy.noise import LEVELS
from sirpy.patch_match import PatchMatch, passes
from sirpy.ply import read_vertices
from sirpy.rectangle import Grid, Rectangle
from sirpy.stereo_backend import StereoOptions
from sirpy.synthetic import read_truth, render_scene
from sirpy.view_selection import read_views, views
from sirpy.view_windows import MOST_LEVEL
from sirpy.windows import read_map
from sirpy.workspace import Workspace
from tele_scene import wide_and_tele

# More than any pass reaches, and far less.
FULL, NONE = 1000, 0
# Few sweeps: a pixel depends on little around it, so the windows of sub-images are less than the photograph.
QUICK = StereoOptions(
    native_iterations=1, geometric_iterations=1, speckle_pixels=8, top_views=2, threads=2
)


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """5 photographs, one of them oblique: some of what a block allows sees nothing of a sub-image."""
    folder = tmp_path_factory.mktemp("field")
    return render_scene(folder, image_count=5, size=(432, 200), camera_model="OPENCV", seed=5)


@pytest.fixture(scope="module", autouse=True)
def short_passes() -> Iterator[None]:
    """One sweep in every pass."""

    def shortened(coarsest: int, options: StereoOptions, top: int) -> list[PatchMatch]:
        return [replace(one, iterations=1) for one in passes(coarsest, options, top)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(patch_match, "passes", shortened)
        yield


def _stereo(
    scene: Path,
    output: Path,
    grid: Grid,
    halo: int,
    threads: int = 2,
    region: Region = Region(),
    options: StereoOptions = QUICK,
) -> Workspace:
    workspace = cut(
        scene / "images",
        scene / "sparse",
        output,
        grid=grid,
        region=region,
        pixels=PixelOptions(
            format="png"
        ),  # JPEG compresses the pixels of other sub-images otherwise
    )
    views(workspace, num_sources=2, halo=halo)
    stereo(workspace, options=replace(options, threads=threads))
    return workspace


def _maps(workspace: Workspace) -> dict[str, NDArray[Any]]:
    """Of each native image: depth, normal, reason, confidence, deviation, level, (8, height, width), put together
    of the cores."""
    maps = {}
    for native in workspace.natives:
        planes = np.full((8, native.height, native.width), -1, np.float32)  # what is not cut
        for sub in native.sub_images:
            found = [
                read_map(workspace.depth_map(sub, "geometric"))[None],
                read_map(workspace.normal_map(sub, "geometric")),
                read_map(workspace.reason_map(sub))[None],
                read_map(workspace.confidence_map(sub))[None],
                read_map(workspace.sigma_map(sub))[None],
                read_map(workspace.level_map(sub))[None],
            ]
            core = (slice(None), *sub.core.slices_in(sub.stored))
            planes[(slice(None), *sub.core.slices_in(native.rectangle))] = np.concatenate(found)[
                core
            ]
        maps[native.name] = planes
    return maps


def _sorted_points(workspace: Workspace) -> NDArray[np.void]:
    fuse(workspace)
    points = read_vertices(workspace.fused)
    return np.sort(points, order=["x", "y", "z"])


@pytest.fixture(scope="module")
def whole(field: Path, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return _stereo(field, tmp_path_factory.mktemp("whole"), Grid(1, 1), FULL, threads=1)


@pytest.mark.parametrize("side", [3, 5])
def test_with_the_full_halo_a_grid_changes_nothing(
    field: Path, whole: Workspace, tmp_path: Path, side: int
) -> None:
    cut_up = _stereo(field, tmp_path, Grid(side, side), FULL)
    expected, found = _maps(whole), _maps(cut_up)
    for name, planes in expected.items():
        assert (planes[0] > 0).mean() > 0.3
        np.testing.assert_array_equal(found[name], planes, name)
    assert (_sorted_points(cut_up) == _sorted_points(whole)).all()


def test_with_the_default_passes_a_grid_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patch_match, "passes", passes)
    options, halo = StereoOptions(), 161
    of_sub_images = [one for one in passes(2, options) if one.level < 2]
    assert max(one.margin + options.margin * one.is_last for one in of_sub_images) <= halo
    scene = render_scene(tmp_path / "scene", image_count=3, size=(480, 110), seed=5)
    expected, found = (
        _maps(_stereo(scene, tmp_path / str(grid), grid, halo, options=options))
        for grid in (Grid(1, 1), Grid(3, 2))
    )
    for name, planes in expected.items():
        np.testing.assert_array_equal(found[name], planes, name)
    assert sum((planes[0] > 0).sum() for planes in expected.values()) > 20_000


def test_of_a_region_of_interest_a_grid_changes_nothing(field: Path, tmp_path: Path) -> None:
    # Its corners lie inside pixels of the coarser levels; a sub-image is a pixel wide.
    region = Region(roi=Rectangle(53, 31, 301, 130))
    expected, found = (
        _maps(_stereo(field, tmp_path / str(grid), grid, FULL, region=region))
        for grid in (Grid(1, 1), Grid.with_cuts((54, 199), (80,)))
    )
    for name, planes in expected.items():
        assert (planes[0] >= 0).sum() == 301 * 130
        np.testing.assert_array_equal(found[name], planes, name)
    assert sum((planes[0] > 0).sum() for planes in expected.values()) > 5000


def test_what_is_narrower_than_a_coarse_pixel_starts_at_a_finer_level(
    field: Path, tmp_path: Path
) -> None:
    # No pixel of level 2 begins in it, and one column of level 1.
    narrow = "strip1_002.jpg"
    region = Region(rois={narrow: Rectangle(201, 20, 3, 150)})
    expected, found = (
        _maps(_stereo(field, tmp_path / str(grid), grid, FULL, region=region))
        for grid in (Grid(1, 1), Grid(1, 3))
    )
    assert (expected[narrow][0] >= 0).sum() == 3 * 150
    assert (expected[narrow][0] > 0).sum() > 100
    for name, planes in expected.items():
        np.testing.assert_array_equal(found[name], planes, name)
    # Of every photograph a single native pixel: there is nothing to match.
    speck = _stereo(field, tmp_path / "1", Grid(1, 1), FULL, region=Region(Rectangle(5, 5, 1, 1)))
    assert all((planes[0] <= 0).all() for planes in _maps(speck).values())


def test_photographs_may_be_searched_from_the_coarsest_level_that_there_is(
    field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As of photographs with a shorter side of 3,072 pixels and more; these have 3 x 1 there.
    assert LEVELS > MOST_LEVEL
    monkeypatch.setattr("sirpy.dense_stereo.top_level", lambda sizes, coarsest: MOST_LEVEL)
    found = _maps(_stereo(field, tmp_path, Grid(1, 1), FULL))
    for planes in found.values():
        assert (planes[0] > 0).mean() > 0.3


def test_maps_that_are_deleted_are_made_again(whole: Workspace, tmp_path: Path) -> None:
    workspace = Workspace(shutil.copytree(whole.folder, tmp_path / "out"))
    maps = [workspace.stereo_maps(sub) for _, sub in workspace.sub_images()]
    untouched = {path: path.stat().st_mtime_ns for path in maps[-1]}
    for index in range(len(maps[0])):  # another kind of each of the first photographs
        maps[index % 4][index].unlink()
    stereo(workspace, options=QUICK)
    for path in (path for paths in maps for path in paths):
        assert path.read_bytes() == (whole.folder / path.relative_to(workspace.folder)).read_bytes()
    assert untouched == {path: path.stat().st_mtime_ns for path in maps[-1]}
    assert not workspace.passes.exists()


def test_a_source_that_samples_more_finely_is_matched_at_a_coarser_level(tmp_path: Path) -> None:
    scene = wide_and_tele(tmp_path / "scene")
    workspace = _stereo(scene, tmp_path / "out", Grid(2, 1), FULL)
    found, truth = read_views(workspace), read_truth(scene)
    assert [source.level for source in found.fields["wide.png"].sources] == [1]
    assert [source.level for source in found.fields["tele.png"].sources] == [0]
    model = pycolmap.Reconstruction(workspace.native_model)
    cameras = read_native_scene(workspace).cameras
    for image in model.images.values():
        camera, depth = cameras[image.name], _maps(workspace)[image.name][0]
        exact = truth.depth_map(model.cameras[image.camera_id], image.cam_from_world())
        (other,) = (one for one in cameras.values() if one is not camera)
        y, x = (axis.ravel() + 0.5 for axis in np.indices(exact.shape))
        seen = other.project(camera.world(np.column_stack([x, y]), exact.ravel().astype(float)))
        border = 16
        size = np.array([other.width, other.height])
        inside = ((seen > border) & (seen < size - border)).all(axis=1).reshape(exact.shape)
        assert inside.sum() > 5000
        # The base is a fifth of the height: a pixel of the wide one is half a metre of depth.
        error = (depth - exact)[inside]
        assert (np.abs(error) < 0.5).mean() > 0.75
        assert abs(np.median(error[depth[inside] > 0])) < 0.05


def test_without_a_halo_a_grid_is_felt(field: Path, whole: Workspace, tmp_path: Path) -> None:
    cut_up = _maps(_stereo(field, tmp_path, Grid(3, 3), NONE))
    assert any((cut_up[name] != planes).any() for name, planes in _maps(whole).items())
