"""What `benchmarks/cameras.py` says of cameras that are wrong by known amounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from camera_errors import common_views, judge, triangulate
from cameras import linked_by_lens
from sirpy.model_arrays import PosedImage, SparseModel
from test_stereo_benchmarks import OPENCV

CORNERS = np.array([[-3.0, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]])
POINTS = np.random.default_rng(0).uniform([-2, -2, 9], [2, 2, 11], (60, 3))
FAR = 10.0


def lens(camera_id: int, *, shift: tuple[float, float] = (0, 0)) -> pycolmap.Camera:
    parameters = list(OPENCV.params)
    parameters[2] += shift[0]
    parameters[3] += shift[1]
    return pycolmap.Camera(
        camera_id=camera_id, model="OPENCV", width=1000, height=701, params=parameters
    )


def block(
    centres: np.ndarray = CORNERS,
    *,
    shifts: dict[int, tuple[float, float]] | None = None,
    turns: dict[int, float] | None = None,
) -> SparseModel:
    """Photographs that look at the middle of the points from `centres`, a lens each, all points in all of them.

    Args:
        shifts: of principal points, px.
        turns: about the axis of view, degrees.
    """
    images = []
    for i, (centre, true) in enumerate(zip(centres, CORNERS, strict=False)):
        ahead = np.array([0, 0, FAR]) - true
        ahead /= np.linalg.norm(ahead)
        right = np.cross([0, 1, 0], ahead) / np.linalg.norm(np.cross([0, 1, 0], ahead))
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        angle = np.radians((turns or {}).get(i, 0.0))
        roll = pycolmap.Rotation3d(np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)]))
        x, y, z, w = pycolmap.Rotation3d(roll.matrix() @ rotation).quat
        shift = -roll.matrix() @ rotation @ centre
        images.append(PosedImage(i + 1, i + 1, f"{i}.jpg", (w, x, y, z, *shift)))
    count, points = len(images), len(POINTS)
    return SparseModel(
        {i + 1: lens(i + 1, shift=(shifts or {}).get(i, (0, 0))) for i in range(count)},
        tuple(images),
        np.arange(1, points + 1, dtype=np.uint64),
        POINTS,
        np.zeros((points, 3), np.uint8),
        np.zeros(points),
        points * np.arange(count + 1, dtype=np.int64),
        np.zeros((count * points, 2)),
        np.tile(np.arange(points, dtype=np.int32), count),
    )


def moved(model: SparseModel) -> SparseModel:
    """In another frame."""
    turn = pycolmap.Rotation3d(np.array([0.3, -0.5, 0.2, 0.8]))
    turn.normalize()
    similarity = pycolmap.Sim3d(37.0, turn, np.array([1000.0, -2000, 300]))
    images = []
    for image in model.images:
        cam_from_world = image.cam_from_world
        rotation = cam_from_world[:, :3] @ turn.matrix().T
        centre = similarity * (-cam_from_world[:, :3].T @ cam_from_world[:, 3])
        x, y, z, w = pycolmap.Rotation3d(rotation).quat
        images.append(replace(image, pose=(w, x, y, z, *(-rotation @ centre))))
    return replace(model, images=tuple(images))


def numbers(value: object) -> list[float]:
    """All of them, in the order of a nested dictionary."""
    if isinstance(value, dict):
        return [number for one in value.values() for number in numbers(one)]
    return [value] if isinstance(value, float) else []


def test_exact_cameras_in_another_frame_have_no_error() -> None:
    found = judge(moved(block()), block())
    assert (found["photographs"], found["points"], found["observations"]) == (4, 60, 240)
    assert found["gsd"] == pytest.approx(10.8 / 905, rel=0.05)
    assert max(numbers({**found, "gsd": None})) < 1e-6


def test_errors_do_not_depend_on_the_frame_of_the_model() -> None:
    bent = CORNERS + np.array([[0.02, 0, 0.01], [0, 0.03, -0.02], [0, 0, 0.01], [0.01, 0, 0]])
    wrong = block(bent, shifts={1: (0.5, -0.3)}, turns={2: 0.01})
    here, there = (judge(model, block()) for model in (wrong, moved(wrong)))
    assert here["consistency_px"]["rms"] > 0.1
    np.testing.assert_allclose(numbers(here), numbers(there), atol=3e-6)


def test_centres_bent_as_no_similarity_bends_them_have_that_error() -> None:
    bent = CORNERS + 0.03 * np.array([[0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1]])
    centres = judge(block(bent), block())["by_centres"]
    for figure in ("rms", "median", "max"):
        assert centres["centres"][figure] == pytest.approx(0.03, rel=1e-3)
    assert centres["rotations_deg"]["max"] < 1e-3


def test_a_camera_turned_about_its_axis_has_that_angle() -> None:
    found = judge(block(turns={2: 0.4}), block())
    assert found["images"]["2.jpg"]["rotation_deg"] == pytest.approx(0.4, abs=1e-5)
    assert found["by_centres"]["rotations_deg"]["rms"] == pytest.approx(0.2, abs=1e-5)
    assert found["by_centres"]["centres"]["max"] < 1e-6


def test_a_shifted_principal_point_is_seen_in_its_photograph_alone() -> None:
    found = judge(block(shifts={1: (0.3, 0.4)}), block())
    assert found["images"]["1.jpg"]["reprojection_px"]["max"] == pytest.approx(0.5, abs=1e-5)
    assert found["images"]["0.jpg"]["reprojection_px"]["max"] < 1e-5
    assert found["by_centres"]["reprojection_px"]["rms"] == pytest.approx(0.25, abs=1e-5)
    # The points follow it in part, so that the other photographs see something of it.
    assert 0.01 < found["consistency_px"]["rms"] < 0.25
    assert found["images"]["0.jpg"]["consistency_px"]["rms"] > 0.01


def test_two_cameras_share_what_lies_across_their_epipolar_lines() -> None:
    """Side by side and alike: 0.6 px along the rows moves the point, across them each is left with the half."""
    side = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    truth, wrong = (parallel(side, shifts) for shifts in ([(0, 0), (0, 0)], [(0, 0), (0.6, 0.6)]))
    views = common_views(wrong, truth, 100)
    points = triangulate(views, len(POINTS))
    for view, sign in zip(views, (1, -1), strict=True):
        error = view.camera.project(points) - view.pixel
        np.testing.assert_allclose(error, np.tile([0, -sign * 0.3], (60, 1)), atol=2e-3)


def parallel(centres: np.ndarray, shifts: Sequence[tuple[float, float]]) -> SparseModel:
    """Photographs that look along z, without lens distortion."""
    model = block(CORNERS[: len(centres)])
    cameras = {
        i + 1: pycolmap.Camera(
            camera_id=i + 1,
            model="PINHOLE",
            width=1000,
            height=701,
            params=[900, 900, 500 + x, 350 + y],
        )
        for i, (x, y) in enumerate(shifts)
    }
    images = tuple(
        replace(image, pose=(1, 0, 0, 0, *(-centre)))
        for image, centre in zip(model.images, centres, strict=True)
    )
    return replace(model, cameras=cameras, images=images)


def test_a_triangulated_point_is_the_best_there_is() -> None:
    wrong = block(shifts={1: (3, -2), 2: (-1, 4)}, turns={3: 0.3})
    views = common_views(wrong, block(), 100)
    points = triangulate(views, len(POINTS))

    def squares(shift: np.ndarray) -> np.ndarray:
        errors = [view.camera.project(points + shift) - view.pixel for view in views]
        return np.sum(np.square(errors), axis=(0, 2))

    best = squares(np.zeros(3))
    assert best.min() > 0.1
    for axis in np.eye(3):
        for step in (1e-3, -1e-3):
            assert (squares(step * axis) > best).all()


def test_what_is_missing_is_named() -> None:
    found = judge(block().taking([0, 1, 3]), block())
    assert (found["photographs"], found["missing"]) == (3, ["2.jpg"])


def test_points_behind_a_camera_are_counted_and_have_no_number() -> None:
    whole = block()
    of_last = np.arange(180, 200)  # its 20 points, of 60
    truth = replace(
        whole,
        starts=np.array([0, 60, 120, 180, 200]),
        point=whole.point[: of_last[-1] + 1],
        xy=whole.xy[: of_last[-1] + 1],
    )
    away = replace(whole.images[3], pose=(0, 1, 0, 0, *CORNERS[3]))  # turned to where no point is
    found = judge(replace(truth, images=(*truth.images[:3], away)), truth)
    assert (found["points"], found["points_lost"]) == (40, 20)
    assert found["images"]["3.jpg"]["reprojection_px"]["rms"] is None
    assert found["consistency_px"]["max"] < 1e-6


def test_models_of_decimated_photographs_are_refused() -> None:
    whole = block()
    small = lens(1)
    small.rescale(500, 350)
    with pytest.raises(SystemExit, match=r"0\.jpg has another size"):
        judge(replace(whole, cameras={**whole.cameras, 1: small}), whole)


def test_photographs_are_linked_by_lens(tmp_path: Path) -> None:
    whole = block()
    whole = replace(
        whole, images=tuple(replace(one, camera_id=1 + i % 2) for i, one in enumerate(whole.images))
    )
    for image in whole.images:
        (tmp_path / image.name).write_text(image.name)
    named = linked_by_lens(tmp_path, whole, tmp_path / "linked")
    assert [image.name for image in named.images] == ["1/0.jpg", "2/1.jpg", "1/2.jpg", "2/3.jpg"]
    assert (tmp_path / "linked" / "2/3.jpg").read_text() == "3.jpg"
