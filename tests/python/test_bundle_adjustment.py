"""Weighted bundle adjustment finds the cameras that made the observations."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from sirpy import _adjustment
from sirpy.bundle_adjustment import Intrinsics, bundle_adjust
from sirpy.errors import InputError

Floats = NDArray[np.float64]
WIDTH, HEIGHT, FOCAL = 1000, 800, 900.0
LENSES = {
    "SIMPLE_PINHOLE": [],
    "PINHOLE": [],
    "SIMPLE_RADIAL": [-0.05],
    "RADIAL": [-0.05, 0.01],
    "OPENCV": [-0.05, 0.01, 1e-3, -2e-3],
    "FULL_OPENCV": [-0.05, 0.01, 1e-3, -2e-3, 5e-3, 0.01, -0.02, 3e-3],
    "SIMPLE_RADIAL_FISHEYE": [-0.02],
    "RADIAL_FISHEYE": [-0.02, 5e-3],
    "OPENCV_FISHEYE": [-0.02, 5e-3, 1e-3, -1e-3],
}
UNIT = np.array([[1.0, 0], [0, 1]])
HELD = Intrinsics(focal_length=False, principal_point=False, extra_params=False)


def camera_of(lens: str, camera_id: int = 1) -> pycolmap.Camera:
    camera = pycolmap.Camera.create_from_model_name(camera_id, lens, FOCAL, WIDTH, HEIGHT)
    parameters = camera.params
    parameters[list(camera.principal_point_idxs())] += [6.0, -4.0]
    parameters[list(camera.extra_params_idxs())] = LENSES[lens]
    camera.params = parameters
    return camera


def looking(centre: Floats, target: Floats, roll: float) -> pycolmap.Rigid3d:
    """cam_from_world of a camera at `centre` that looks at `target`."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(roll), np.sin(roll)
    rotation = np.array([c * right + s * down, -s * right + c * down, forward])
    return pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)


def ring(middle: Floats | None = None) -> list[pycolmap.Rigid3d]:
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    off = np.zeros(3) if middle is None else middle
    return [
        looking(off + np.array([5 * np.cos(a), 5 * np.sin(a), -8 - np.sin(3 * a)]), off, roll=2 * a)
        for a in angles
    ]


def world_points(count: int = 300) -> Floats:
    return np.random.default_rng(2).uniform([-3, -3, -0.5], [3, 3, 0.5], (count, 3))


def true_model(
    lens: str = "SIMPLE_RADIAL", middle: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> pycolmap.Reconstruction:
    """Cameras in a ring and their exact observations."""
    points = world_points() + middle
    camera = camera_of(lens)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for image_id, pose in enumerate(ring(np.array(middle)), start=1):
        pixels = np.array([camera.img_from_cam(pose * point) for point in points])
        name = f"{image_id}.jpg"
        image = pycolmap.Image(name=name, camera_id=1, image_id=image_id, keypoints=pixels)
        model.add_image_with_trivial_frame(image, pose)
    return with_points(model, points)


def with_points(model: pycolmap.Reconstruction, points: Floats) -> pycolmap.Reconstruction:
    """Each image sees each point, by the same index."""
    for index, point in enumerate(points):
        track = pycolmap.Track()
        for image_id in sorted(model.images):
            track.add_element(image_id, index)
        model.add_point3D(point, track)
    return model


def disturbed(model: pycolmap.Reconstruction, size: float = 0.01) -> pycolmap.Reconstruction:
    """The same observations, with poses and points off by about `size`."""
    generator = np.random.default_rng(5)
    copy = pycolmap.Reconstruction(model)
    for _, frame in sorted(copy.frames.items()):
        turn = pycolmap.Rotation3d(generator.normal(0, size / 5, 3))
        rotation = turn * frame.rig_from_world.rotation
        centre = frame.rig_from_world.tgt_origin_in_src() + generator.normal(0, size, 3)
        frame.rig_from_world = pycolmap.Rigid3d(rotation, -(rotation * centre))
    for _, point in sorted(copy.points3D.items()):
        point.xyz = point.xyz + generator.normal(0, size, 3)
    return copy


def observed(model: pycolmap.Reconstruction, move: Callable[[int, Floats], Floats]) -> None:
    """Moves each image's points2D: `move`(image id, xy (n, 2))."""
    for image_id, image in sorted(model.images.items()):
        moved = move(image_id, np.array([one.xy for one in image.points2D]))
        for one, xy in zip(image.points2D, moved, strict=True):
            one.xy = xy


def covariances(model: pycolmap.Reconstruction, matrix: Floats = UNIT) -> dict[int, Floats]:
    return {
        i: np.broadcast_to(matrix, (image.num_points2D(), 2, 2))
        for i, image in model.images.items()
    }


def centre_error(model: pycolmap.Reconstruction, truth: pycolmap.Reconstruction) -> float:
    """Rms of the camera centres after the best similarity."""
    names = [image.name for _, image in sorted(truth.images.items())]
    found = np.array([model.find_image_with_name(name).projection_center() for name in names])
    true = np.array([truth.find_image_with_name(name).projection_center() for name in names])
    fit = pycolmap.estimate_sim3d(found, true)
    off = np.array([fit * one for one in found]) - true
    return float(np.sqrt(np.square(off).sum(axis=1).mean()))


@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_projects_as_colmap_does(lens: str) -> None:
    camera = camera_of(lens)
    points = np.random.default_rng(0).uniform([-0.6, -0.5, 0.8], [0.6, 0.5, 1.5], (200, 3))
    points[0] = [0, 0, 1]
    points[1] = [1e-7, -1e-7, 1]
    count, parameters = len(points), len(camera.params)
    projected = -_adjustment.residuals(
        _adjustment.Model(
            cameras=[(lens, camera.params, [True] * parameters, camera.params, [0.0] * parameters)],
            frames=np.array([[0.0, 0, 0, 1, 0, 0, 0]]),
            sensors=np.empty((0, 7)),
            images=np.zeros((1, 3), np.int32) - np.array([0, 0, 1], np.int32),
            points=points,
        ),
        _adjustment.Observations(
            image=np.zeros(count, np.int32),
            point=np.arange(count, dtype=np.int32),
            xy=np.zeros((count, 2)),
            whitening=np.tile([1.0, 0, 0, 1], (count, 1)),
        ),
    )
    assert projected == pytest.approx(camera.img_from_cam(points), abs=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_exact_observations_give_the_exact_cameras(lens: str) -> None:
    truth = true_model(lens)
    start = disturbed(truth)
    start.camera(1).params = start.camera(1).params * 1.01
    refine = Intrinsics(extra_params=lens != "FULL_OPENCV", principal_point=True)
    if lens == "FULL_OPENCV":  # its terms stand for each other: exact pixels, not exact terms
        start.camera(1).params = truth.camera(1).params
    done = bundle_adjust(start, covariances(start), refine=refine)
    assert done.model.camera(1).params == pytest.approx(truth.camera(1).params, rel=1e-5, abs=1e-6)
    assert centre_error(done.model, truth) < 1e-6
    assert max(float(np.abs(one).max()) for one in done.residuals.values()) < 1e-4


def test_another_lens_is_refused_by_name() -> None:
    model = true_model("OPENCV")
    model.camera(1).model = pycolmap.CameraModelId.FOV
    model.camera(1).params = [FOCAL, FOCAL, 500.0, 400.0, 0.5]
    with pytest.raises(InputError, match="a FOV, which cannot be adjusted: use one of SIMPLE_PINH"):
        bundle_adjust(model, covariances(model))


def noisy(outliers: float = 0.0) -> tuple[pycolmap.Reconstruction, dict[int, Floats]]:
    """Each observation good to 0.05 px, or bad, 2 px along one direction; and what is known of
    that."""
    model = true_model()
    generator = np.random.default_rng(3)
    known = {}

    def move(image_id: int, xy: Floats) -> Floats:
        angle = generator.uniform(0, np.pi, len(xy))
        along = np.column_stack([np.cos(angle), np.sin(angle)])
        across = np.column_stack([-along[:, 1], along[:, 0]])
        wide = np.where(generator.uniform(size=len(xy)) < 0.5, 2.0, 0.05)[:, None]
        noise = generator.normal(size=(2, len(xy), 1))
        known[image_id] = np.einsum("ni,nj->nij", wide * along, wide * along)
        known[image_id] += 0.05**2 * np.einsum("ni,nj->nij", across, across)
        moved = xy + noise[0] * wide * along + noise[1] * 0.05 * across
        wrong = generator.uniform(size=len(xy)) < outliers
        moved[wrong] += generator.uniform(-30, 30, (int(wrong.sum()), 2))
        return moved

    observed(model, move)
    return disturbed(model), known


def test_covariances_make_the_cameras_several_times_better_and_sigma0_one() -> None:
    truth = true_model()
    model, known = noisy()
    refine = Intrinsics(principal_point=False)
    weighted = bundle_adjust(model, known, refine=refine)
    unweighted = bundle_adjust(model, covariances(model), refine=refine)
    assert centre_error(weighted.model, truth) < 0.3 * centre_error(unweighted.model, truth)
    assert weighted.sigma0 == pytest.approx(1.0, abs=0.05)


def test_deviations_of_the_lens_are_those_of_its_errors() -> None:
    truth = true_model()
    model, known = noisy()
    done = bundle_adjust(model, known, refine=Intrinsics(principal_point=True))
    deviations = done.intrinsic_deviations[1]
    assert deviations is not None and (deviations > 0).all()
    errors = done.model.camera(1).params - truth.camera(1).params
    assert (np.abs(errors) < 4 * deviations).all()
    assert deviations[0] < 0.5


def test_a_few_gross_errors_do_not_move_the_cameras() -> None:
    truth = true_model()
    refine = Intrinsics(principal_point=False)
    clean = bundle_adjust(*noisy(), refine=refine)
    gross = bundle_adjust(*noisy(outliers=0.03), refine=refine)
    assert centre_error(gross.model, truth) < 1.5 * centre_error(clean.model, truth)
    assert gross.sigma0 == pytest.approx(1.0, abs=0.07)


def test_covariances_that_are_all_too_small_change_nothing_but_sigma0() -> None:
    """Nor do they change what the expected principal point and the known positions weigh."""
    model, known = noisy()
    positions = {
        image.name: (image.projection_center(), np.full(3, 1e-3)) for image in model.images.values()
    }
    right = bundle_adjust(model, known, positions=positions)
    overrated = {i: one / 100 for i, one in known.items()}
    small = bundle_adjust(model, overrated, positions=positions)
    assert small.sigma0 == pytest.approx(10 * right.sigma0, rel=0.02)
    assert centre_error(small.model, right.model) < 2e-4
    shift = small.model.camera(1).params - right.model.camera(1).params
    assert np.abs(shift).max() < 0.02


def test_a_rig_has_one_pose_per_frame_and_one_per_sensor() -> None:
    points = world_points()
    cameras = [camera_of("SIMPLE_RADIAL", 1), camera_of("OPENCV", 2)]
    side = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.05, -0.1, 0.02])), [-0.4, 0.1, 0.05])
    model = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(cameras[0].sensor_id)
    rig.add_sensor(cameras[1].sensor_id, side)
    for camera in cameras:
        model.add_camera(camera)
    model.add_rig(rig)
    for frame_id, pose in enumerate(ring(), start=1):
        frame = pycolmap.Frame(frame_id=frame_id, rig_id=1)
        images = []
        for camera, cam_from_rig in zip(cameras, (pycolmap.Rigid3d(), side), strict=True):
            image_id = 2 * frame_id + camera.camera_id
            pixels = np.array([camera.img_from_cam(cam_from_rig * pose * one) for one in points])
            image = pycolmap.Image(
                name=f"{image_id}.jpg",
                camera_id=camera.camera_id,
                image_id=image_id,
                keypoints=pixels,
            )
            image.frame_id = frame_id
            frame.add_data_id(image.data_id)
            images.append(image)
        frame.rig_from_world = pose
        model.add_frame(frame)
        for image in images:
            model.add_image(image)
    truth = with_points(model, points)
    start = disturbed(truth)
    start.rig(1).set_sensor_from_rig(
        cameras[1].sensor_id, pycolmap.Rigid3d(side.rotation, side.translation + 0.02)
    )
    done = bundle_adjust(start, covariances(start), refine=HELD)
    assert centre_error(done.model, truth) < 1e-6
    found = done.model.rig(1).sensor_from_rig(cameras[1].sensor_id)
    assert found.rotation.angle_to(side.rotation) < 1e-6
    # The frame of the start is kept, and its scale with it: nearly the true one.
    assert np.array(found.translation) == pytest.approx(side.translation, rel=5e-3)


def test_the_frame_is_that_of_all_cameras_of_the_model_far_from_the_origin_too() -> None:
    truth = true_model(middle=(500_000.0, 5_000_000.0, 100.0))
    start = disturbed(truth)
    done = bundle_adjust(start, covariances(start), refine=HELD)
    assert max(float(np.abs(one).max()) for one in done.residuals.values()) < 1e-3
    off = [
        done.model.image(i).projection_center() - start.image(i).projection_center()
        for i in truth.images
    ]
    assert np.mean(off, axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    assert np.abs(off).max() < 0.1


def test_positions_give_the_frame() -> None:
    truth = true_model()
    start = disturbed(truth)
    shift = np.array([0.3, -0.2, 0.1])
    positions = {
        image.name: (image.projection_center() + shift, np.full(3, 0.01))
        for image in truth.images.values()
    }
    done = bundle_adjust(start, covariances(start), refine=HELD, positions=positions)
    for image_id, image in truth.images.items():
        found = done.model.image(image_id).projection_center()
        assert found == pytest.approx(image.projection_center() + shift, abs=1e-4)


@pytest.mark.parametrize("determined", [True, False], ids=["ring", "strip"])
def test_the_principal_point_goes_where_it_is_determined(determined: bool) -> None:
    truth = true_model()
    if not determined:
        model = pycolmap.Reconstruction()
        model.add_camera_with_trivial_rig(camera_of("SIMPLE_RADIAL"))
        for i, x in enumerate(np.linspace(-1.5, 1.5, 5), start=1):
            pose = looking(np.array([x, 0.0, -8.0]), np.array([x, 0.0, 0.0]), roll=0.0)
            points = [pose * point for point in world_points()]
            pixels = camera_of("SIMPLE_RADIAL").img_from_cam(np.array(points))
            model.add_image_with_trivial_frame(
                pycolmap.Image(name=f"{i}.jpg", camera_id=1, image_id=i, keypoints=pixels), pose
            )
        truth = with_points(model, world_points())
    generator = np.random.default_rng(0)
    observed(truth, lambda _, xy: xy + generator.normal(0, 0.3, xy.shape))
    camera = truth.camera(1)
    right = camera.params.copy()
    centred = camera.params
    centred[1:3] = [WIDTH / 2, HEIGHT / 2]
    camera.params = centred
    done = bundle_adjust(truth, covariances(truth, 0.09 * UNIT))
    found = done.model.camera(1).params[1:3]
    assert found == pytest.approx(right[1:3] if determined else centred[1:3], abs=1.0)


def test_points_that_are_seen_once_are_left_out_and_the_model_given_stays() -> None:
    truth = true_model()
    start = disturbed(truth)
    lonely = next(iter(sorted(start.points3D)))
    index = start.point3D(lonely).track.elements[0].point2D_idx
    for image_id in sorted(start.images)[1:]:
        start.image(image_id).reset_point3D_for_point2D(index)
    before = {i: point.xyz.copy() for i, point in start.points3D.items()}
    done = bundle_adjust(start, covariances(start), refine=HELD)
    assert not done.model.exists_point3D(lonely)
    assert np.isnan(done.residuals[1][index]).all()
    assert np.isfinite(np.delete(done.residuals[1], index, axis=0)).all()
    assert all((start.point3D(i).xyz == xyz).all() for i, xyz in before.items())


def test_a_covariance_that_is_none_is_named() -> None:
    model = true_model()
    known = {i: one.copy() for i, one in covariances(model).items()}
    known[2][7] = [[1, 2], [2, 1]]
    with pytest.raises(InputError, match=r"keypoint 7 of 2\.jpg has a covariance"):
        bundle_adjust(model, known)
    # One whose determinant is above zero by rounding alone, and that has no Cholesky factor.
    a, b, c = 0.6068204161887052, 0.6321658267417429, 0.6585698533514664
    for singular in [[a, b], [b, c]], np.zeros((2, 2)), np.full((2, 2), np.nan):
        known[2][7] = singular
        with pytest.raises(InputError, match=r"keypoint 7 of 2\.jpg has a covariance"):
            bundle_adjust(model, known)
    del known[2]
    with pytest.raises(InputError, match=r"the covariances of 2\.jpg are not one 2x2 matrix"):
        bundle_adjust(model, known)


def test_covariances_of_single_precision_serve_too() -> None:
    """A position that is known a thousand times as well across an edge as along it."""
    model = true_model()
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    narrow = (turn @ np.diag([1.0, 1e-6]) @ turn.T).astype(np.float32)
    done = bundle_adjust(disturbed(model), covariances(model, narrow), refine=HELD)
    assert centre_error(done.model, model) < 1e-6


def test_the_same_bytes_from_every_process(tmp_path: Path) -> None:
    model, _ = noisy()
    model.write_binary(tmp_path)
    program = (
        "import sys, hashlib, numpy as np, pycolmap\n"
        "from sirpy.bundle_adjustment import bundle_adjust\n"
        "model = pycolmap.Reconstruction(sys.argv[1])\n"
        "known = {i: np.tile(np.eye(2), (one.num_points2D(), 1, 1))"
        " for i, one in model.images.items()}\n"
        "done = bundle_adjust(model, known)\n"
        "poses = [one.cam_from_world().matrix() for _, one in sorted(done.model.images.items())]\n"
        "xyz = [one.xyz for _, one in sorted(done.model.points3D.items())]\n"
        "parts = (np.array(poses), np.array(xyz), done.model.camera(1).params)\n"
        "print(hashlib.sha256(b''.join(one.tobytes() for one in parts)).hexdigest())\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path)]
    prints = {
        subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
        for _ in range(2)
    }
    assert len(prints) == 1
