"""Views for other engines: cameras, sources of other photographs, depth ranges, notes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from engine_scenes import cut_town, expected_pixels, moved, without_points
from scenes import plane_scene
from sirpy.engine_views import EngineView, engine_views, place_images, precision_note, size_note
from sirpy.errors import InputError
from sirpy.native_images import NativeImage, SubImage
from sirpy.rectangle import Grid
from sirpy.workspace import Workspace

WIDTH, HEIGHT = 800, 600
SCENE = plane_scene(count=5, width=WIDTH, height=HEIGHT)


def _workspace(folder: Path, overlap: int = 0, extension: str = "jpg") -> Workspace:
    """An index of 4 x 3 sub-images of each photograph of SCENE; no images."""
    natives = []
    for name in SCENE.cameras:
        whole = NativeImage(name, WIDTH, HEIGHT, ()).rectangle
        subs = tuple(
            SubImage(
                f"{name[:-4]}_r{row}_c{column}.{extension}",
                row,
                column,
                core,
                core.padded(overlap).intersection(whole),
            )
            for row, column, core in Grid(4, 3).cores(WIDTH, HEIGHT)
        )
        natives.append(NativeImage(name, WIDTH, HEIGHT, subs))
    workspace = Workspace(folder)
    workspace.write_index(natives, [])
    return workspace


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    return _workspace(tmp_path_factory.mktemp("index"))


def test_cameras_are_those_of_the_sub_images_half_a_pixel_less(town: Path, tmp_path: Path) -> None:
    cut = cut_town(town, tmp_path / "out")
    for view, (world, pixels) in zip(engine_views(cut), expected_pixels(cut), strict=True):
        seen = np.column_stack([world, np.ones(len(world))]) @ view.img_from_world.T
        np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] + 0.5, pixels, atol=1e-6)


def _shared(views: list[EngineView], one: EngineView, other: EngineView) -> int:
    """Points that both sub-images see, by the scene's own cameras."""
    inside = []
    for view in (one, other):
        stored = view.sub_image.stored
        pixel = view.camera.project(SCENE.points)
        low, high = [stored.x0, stored.y0], [stored.x1, stored.y1]
        inside.append(((pixel >= low) & (pixel < high)).all(axis=1))
    return int((inside[0] & inside[1]).sum())


def test_sources_are_of_other_photographs_and_show_the_same_ground(workspace: Workspace) -> None:
    views = engine_views(workspace, scene=SCENE)
    assert [view.number for view in views] == list(range(5 * 12))
    for view in views:
        listed = [number for number, _ in view.sources]
        scores = [score for _, score in view.sources]
        assert len(set(listed)) == len(listed)
        assert scores == sorted(scores, reverse=True)
        others = [one for one in views if one.camera.name != view.camera.name]
        assert set(listed) <= {one.number for one in others}
        shared = {one.number: _shared(views, view, one) for one in others}
        # Nothing that shows a good part of the same ground is missing, and the first shows much of it.
        most = max(shared.values())
        assert {number for number, n in shared.items() if n > most / 3} <= set(listed)
        assert shared[listed[0]] > most / 2


def test_the_best_sources_are_kept(workspace: Workspace) -> None:
    everything = engine_views(workspace, scene=SCENE)
    best = engine_views(workspace, scene=SCENE, most_sources=3)
    assert [view.sources[:3] for view in everything] == [view.sources for view in best]


def test_a_sub_image_without_points_has_the_depths_and_sources_of_those_around(
    workspace: Workspace,
) -> None:
    scene = without_points(SCENE, "002.jpg", (0, WIDTH / 2))
    (view,) = engine_views(workspace, only={"002_r1_c0.jpg"}, scene=scene)
    assert view.number == 2 * 12 + 4
    assert 80 < view.min_depth < 98 and 102 < view.max_depth < 120
    assert view.sources


def test_a_photograph_without_points_has_neither(workspace: Workspace) -> None:
    scene = without_points(SCENE, "002.jpg", (0, WIDTH))
    views = engine_views(workspace, scene=scene)
    blind = [view for view in views if view.camera.name == "002.jpg"]
    assert {(view.min_depth, view.max_depth, view.sources) for view in blind} == {(0.0, 0.0, ())}
    sources = {number for view in views for number, _ in view.sources}
    assert not sources & {view.number for view in blind}


def test_notes_say_what_an_engine_cannot_hold(workspace: Workspace) -> None:
    views = engine_views(workspace, scene=SCENE)
    assert size_note(views, "X") == ""
    assert precision_note(views, "X") == ""
    far = moved(SCENE, np.array([500_000.0, 5_000_000.0, 0.0]))
    note = precision_note(engine_views(workspace, scene=far), "X")
    assert note.startswith("X holds cameras as 32-bit numbers, steps of 0.6")


def test_uneven_sizes_are_said(tmp_path: Path) -> None:
    views = engine_views(_workspace(tmp_path, overlap=8), scene=SCENE)
    assert "have 4 (208x208, 208x216, 216x208 ...)" in size_note(views, "X")


def test_other_files_than_jpeg_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    workspace = _workspace(tmp_path, extension="png")
    views = engine_views(workspace, scene=SCENE)
    with pytest.raises(InputError, match=r"X reads JPEG, and .*000_r0_c0\.png is none"):
        place_images(workspace, views, workspace.mvsnet_image, "copy", "X")
    assert not workspace.images.exists()
