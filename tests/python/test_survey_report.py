"""The page shows a survey: plan, residuals, heights, orthophoto and coverage, each when it is there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from cloud_parts import UTM
from sirpy.alignment import Alignment, Residual, write_alignment
from sirpy.frame import Frame
from sirpy.native_scene import NativeCamera, NativeScene, Observations
from sirpy.residual_plot import residuals
from sirpy.survey_report import _footprint, _in_frame, survey_sections
from sirpy.workspace import Workspace
from test_survey_pictures import write_raster


def camera_above(name: str, x: float, y: float) -> NativeCamera:
    """100 x 80 pixels, 10 above level ground, looking down; a pixel is 0.1 on the ground, rows go south."""
    rotation = np.diag([1.0, -1.0, -1.0])
    intrinsics = np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]])
    shift = -rotation @ np.array([x, y, 10.0])
    return NativeCamera(name, 100, 80, intrinsics, np.column_stack([rotation, shift]))


def scene_of(*cameras: NativeCamera) -> NativeScene:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, -1.0, 0.0], [20.0, 5.0, 0.0]])
    seen = {
        one.name: Observations(np.arange(4), one.project(points), one.in_camera(points)[:, 2])
        for one in cameras
    }
    return NativeScene({one.name: one for one in cameras}, points, seen)


@pytest.mark.parametrize("frame", [Frame(), UTM])
def test_a_camera_in_the_frame_sees_the_same_pixels(frame: Frame) -> None:
    camera = camera_above("a.jpg", 3, -2)
    points = np.random.default_rng(0).uniform(-3, 3, (20, 3))
    moved = _in_frame(camera, frame)
    assert np.allclose(moved.project(frame.world(points)), camera.project(points))
    assert np.allclose(moved.centre, frame.world(camera.centre[None]))


def test_the_footprint_is_what_the_photograph_sees_of_the_ground() -> None:
    found = _footprint(scene_of(camera_above("a.jpg", 3, -2)), "a.jpg", UTM)
    corners = np.array([[-2, -6, 0], [8, -6, 0], [8, 2, 0], [-2, 2, 0.0]])
    truth = UTM.world(corners)[:, :2]
    assert len(found) == 4
    assert np.abs(found[:, None] - truth[None]).max(axis=2).min(axis=1).max() < 1e-6


def test_parts_that_are_not_there_are_left_out(tmp_path: Path) -> None:
    assert not any(survey_sections(Workspace(tmp_path)))


def test_the_plan_has_every_photograph_and_tile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = Workspace(tmp_path)
    workspace.native_model.mkdir()
    scene = scene_of(camera_above("<a>.jpg", 0, 0), camera_above("b.jpg", 20, 5))
    monkeypatch.setattr("sirpy.survey_report.read_native_scene", lambda _: scene)
    monkeypatch.setattr("sirpy.survey_report.read_frame", lambda _: UTM)
    workspace.tile("x0_y0", "dsm.tif").parent.mkdir()
    for name in ("x0_y0", "x1_y0"):
        write_raster(workspace.tile(name, "dsm.tif"), np.zeros((1, 4, 4), np.float32))
    [plan] = [part for part in survey_sections(workspace) if part]
    assert plan.count("<polygon") == 2 + 2 and plan.count("<circle") == 2
    assert "&lt;a&gt;.jpg" in plan and "<a>" not in plan and "dashed, the tiles" in plan
    width, height = map(float, re.findall(r'viewBox="0 0 (\S+) ([^"]+)"', plan)[0])
    for places in re.findall(r'points="([^"]+)"', plan):
        xy = np.array([place.split(",") for place in places.split()], float)
        assert (xy >= 0).all() and (xy <= (width, height)).all()


def test_heights_and_orthophoto_are_shown(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    heights = np.linspace(400, 500, 300, dtype=np.float32).reshape(1, 15, 20)
    write_raster(workspace.surface_model, heights)
    write_raster(workspace.orthophoto, np.full((3, 15, 20), 99, np.uint8))
    surface, ortho = [part for part in survey_sections(workspace) if part]
    assert "401" in surface and "499" in surface and "data:image/jpeg;base64," in surface
    assert "The orthophoto" in ortho


def test_residuals_are_in_the_table_and_in_the_plot(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    found = (
        Residual("a.jpg", "used", 0.5, -1.0, 0.25),
        Residual("b.jpg", "check", -1.0, 0.0, 1.5, 0.75),
        Residual("c.jpg", "outlier", 4000.0, 0.0, 0.0),
    )
    write_alignment(workspace, Alignment("positions", UTM, found))
    page = residuals(workspace)
    for text in ("a list of camera positions", "0.500", "-1.000", "1.146", "0.75", "4000.000"):
        assert text in page
    assert "used: rms 0.5, 1, 0.25 m in x, y, z" in page and "not used: c.jpg" in page
    dots = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="3"[^>]*><title>(\w+)', page)
    # The ring is 2 m, 100 wide; an outlier 4 km away is not drawn, nor does it set the scale.
    assert ("135.0", "160.0", "a") in dots and ("250.0", "97.5", "a") in dots
    assert [name for x, _, name in dots if x != "250.0"] == ["a", "b"]


def test_many_residuals_are_folded(tmp_path: Path) -> None:
    workspace = Workspace(tmp_path)
    found = tuple(Residual(f"{i}.jpg", "used", 0.1, 0.1, 0.1) for i in range(50))
    write_alignment(workspace, Alignment("exif", Frame(), found))
    assert "<summary>All 50 positions</summary>" in residuals(workspace)


def test_a_model_that_came_with_its_frame_has_no_residuals(tmp_path: Path) -> None:
    write_alignment(Workspace(tmp_path), Alignment("declared", UTM))
    assert residuals(Workspace(tmp_path)) == ""
