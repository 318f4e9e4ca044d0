"""Control points: where the model has them, by their marks in distorted photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from sirpy.errors import InputError
from sirpy.ground_control import (
    ControlPoints,
    Mark,
    distances,
    intersect,
    read_control_points,
    read_marks,
)
from sirpy.model_arrays import SparseModel, read_arrays
from sirpy.places import Places
from sirpy.progress import Progress

Floats = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def model(town: Path) -> SparseModel:
    return read_arrays(town / "sparse")


def marks_of(model: SparseModel, points: Floats, noise: float = 0.0, seed: int = 0) -> list[Mark]:
    """Where the photographs see points (n, 3), named by their numbers."""
    random = np.random.default_rng(seed)
    marks = []
    for number, xyz in enumerate(points):
        for index, image in enumerate(model.images):
            camera = model.camera_of(image)
            in_camera = image.cam_from_world @ [*xyz, 1]
            xy = np.asarray(camera.img_from_cam(in_camera[None]))[0]
            if (
                in_camera[2] > 0
                and ((xy >= 5) & (xy <= [camera.width - 5, camera.height - 5])).all()
            ):
                marks.append(Mark(str(number), index, xy + noise * random.normal(size=2)))
    return marks


def well_seen(model: SparseModel, count: int, views: int = 3) -> Floats:
    """Sparse points that so many photographs see."""
    seen = np.bincount(model.point, minlength=len(model.points))
    points: Floats = model.points[np.flatnonzero(seen >= views)]
    return points[:: max(1, len(points) // count)][:count]


def test_rays_meet_where_the_point_is(model: SparseModel) -> None:
    points = well_seen(model, 20)
    met = intersect(model, marks_of(model, points))
    found = np.array([met[str(number)].xyz for number in range(len(points))])
    np.testing.assert_allclose(found, points, atol=1e-6)


def test_the_covariance_is_that_of_the_errors(model: SparseModel) -> None:
    point = well_seen(model, 1)
    repeated = np.repeat(point, 400, axis=0)
    met = intersect(model, marks_of(model, repeated, noise=0.5))
    errors = np.array([one.xyz for one in met.values()]) - point
    predicted = np.mean([one.covariance for one in met.values()], axis=0)
    np.testing.assert_allclose(
        np.sqrt(np.diag(np.cov(errors.T))), np.sqrt(np.diag(predicted)), rtol=0.2
    )


def test_a_mark_that_does_not_fit_is_left_out(model: SparseModel) -> None:
    points = well_seen(model, 15)
    marks = marks_of(model, points, noise=0.3)
    wrong = next(mark for mark in marks if mark.point == "7")
    wrong.xy[0] += 40
    met = intersect(model, marks)
    left_out = [(mark, away) for point in met.values() for mark, away in point.left_out]
    assert [mark for mark, _ in left_out] == [wrong]
    assert left_out[0][1] == pytest.approx(40, abs=3)
    assert wrong not in met["7"].marks
    assert np.linalg.norm(met["7"].xyz - points[7]) < 10 * np.sqrt(np.trace(met["7"].covariance))


def test_one_ray_is_no_point(model: SparseModel) -> None:
    marks = marks_of(model, well_seen(model, 5))
    first = [mark for mark in marks if mark.point == "0"][:1]
    same = Mark("1", first[0].image, first[0].xy)
    assert intersect(model, [*first, same, same]) == {}


def test_distances_are_pixels_of_the_photograph(model: SparseModel) -> None:
    points = well_seen(model, 1)
    marks = marks_of(model, points)
    np.testing.assert_allclose(distances(model, points[0], marks), 0, atol=1e-9)
    moved = [Mark(mark.point, mark.image, mark.xy + np.array([3, 4])) for mark in marks]
    np.testing.assert_allclose(distances(model, points[0], moved), 5, atol=1e-9)
    behind = points[0] + [0, 0, 1e4]
    assert np.isinf(distances(model, behind, marks)).all()


POINTS = "id,x,y,z,sigma,sigma_z,check\n1,10,20,30,0.02,0.04,\n2,11,21,31,0.02,0.04,yes\n"


def test_a_table_of_points(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(POINTS)
    found = read_control_points(path, None)
    assert found.places.names == ("1", "2")
    np.testing.assert_array_equal(found.sigmas, [[0.02, 0.02, 0.04]] * 2)
    assert found.check.tolist() == [False, True]
    assert read_control_points(path, None, ["1"]).check.tolist() == [True, True]
    path.write_text("gcp;easting;northing;height\n1;1;2;3\n")
    assert read_control_points(path, None).sigmas.tolist() == [[0, 0, 0]]


@pytest.mark.parametrize(
    ("text", "check", "why"),
    [
        (POINTS.replace("0.04,yes", "-1,yes"), (), "line 3 .* sigma of -1"),
        (POINTS.replace("yes", "perhaps"), (), "line 3 .* 'perhaps' for check"),
        (POINTS, ("3",), "no point 3, which --check names"),
        (POINTS + "1,2,3,4,0,0,\n", (), "line 4 .* names 1 again"),
        (POINTS.replace("11,", "eleven,"), (), "line 3 .* 'eleven' for x"),
    ],
)
def test_tables_of_points_that_are_wrong(
    tmp_path: Path, text: str, check: tuple[str, ...], why: str
) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=why):
        read_control_points(path, None, check)


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("IMAGE,3,10,10", "line 2 .* marks the point 3, whose coordinates are not given"),
        ("IMAGE,1,10,10\nIMAGE,1,11,10", "line 3 .* marks 1 in .* again"),
        ("IMAGE,1,1000,10", r"line 2 .* marks \(1000, 10\) .* 360x240"),
        ("IMAGE,1,-1,10", r"line 2 .* marks \(-1, 10\)"),
        ("IMAGE,1,inf,10", "line 2 .* 'inf' for x"),
        ("other.jpg,1,10,10", "no mark in a photograph of the model"),
    ],
)
def test_tables_of_marks_that_are_wrong(
    tmp_path: Path, model: SparseModel, rows: str, why: str
) -> None:
    path = tmp_path / "marks.csv"
    path.write_text(f"image,id,x,y\n{rows}\n".replace("IMAGE", model.images[0].name))
    points = ControlPoints(
        Places(("1",), np.zeros((1, 3)), None), np.zeros((1, 3)), np.zeros(1, bool)
    )
    with pytest.raises(InputError, match=why):
        read_marks(path, model, points, Progress())
