"""The similarity that most points agree on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from sirpy.frame import Frame
from sirpy.similarity import robust_similarity

Floats = npt.NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])
seeds = st.integers(0, 2**32 - 1)


def a_frame(random: np.random.Generator) -> Frame:
    """From anywhere to coordinates of a CRS."""
    rotation = Rotation.random(random_state=int(random.integers(2**31))).as_matrix()
    shift = np.array([5e5, 5.4e6, 300]) + random.uniform(-1e5, 1e5, 3)
    return Frame(None, float(np.exp(random.uniform(-5, 5))), rotation, shift)


def up_of(frame: Frame) -> Floats:
    up: Floats = frame.rotation.T @ UP
    return up


@given(seeds, st.integers(3, 40))
@settings(max_examples=40, deadline=None)
def test_exact_points_give_the_exact_similarity(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    truth = a_frame(random)
    model = random.normal(size=(count, 3)) * [5, 5, 0.5] + random.normal(size=3) * 100
    # An up direction that is off by 10 degrees has no say.
    wrong = Rotation.from_rotvec(np.radians([10, 0, 0])).apply(up_of(truth))
    found = robust_similarity(model, truth.world(model), up=wrong)
    away = found.frame.world(model) - truth.world(model)
    assert np.abs(away).max() < 1e-6 * np.ptp(truth.world(model), axis=0).max() + 1e-7
    assert found.used.all()


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_a_third_of_the_points_may_be_wrong(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = a_frame(random)
    model = random.uniform(-1, 1, (30, 3)) * [10, 6, 1]
    world = truth.world(model)
    noise = 0.01 * truth.scale
    world += random.normal(size=world.shape) * noise
    wrong = random.permutation(30)[:10]
    direction = random.normal(size=(10, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    world[wrong] += direction * 10 ** random.uniform(1.5, 6, (10, 1)) * noise
    found = robust_similarity(model, world, up=up_of(truth))
    assert not found.used[wrong].any()
    assert found.used.sum() >= 19
    assert np.abs(found.frame.world(model) - truth.world(model)).max() < 3 * noise


def test_one_of_four_is_found() -> None:
    random = np.random.default_rng(3)
    truth = a_frame(random)
    model = np.array([[0, 0, 0], [10, 0, 1], [10, 8, 0], [0, 8, 0.5]], float)
    world = truth.world(model)
    world[2, 0] += 1000 * truth.scale
    assert robust_similarity(model, world, up=up_of(truth)).used.tolist() == [
        True,
        True,
        False,
        True,
    ]


def test_up_holds_the_turn_about_a_line() -> None:
    random = np.random.default_rng(5)
    truth = a_frame(random)
    model = np.linspace(0, 1, 9)[:, None] * [3.0, 1.0, 0.2]
    found = robust_similarity(model, truth.world(model), up=up_of(truth))
    assert found.turn_sigma > 90
    apart = np.array([[0.0, 1, 1], [2, -1, 0.5]])
    np.testing.assert_allclose(
        found.frame.world(apart), truth.world(apart), atol=1e-4 * truth.scale
    )


def test_the_turn_is_known_as_badly_as_it_says() -> None:
    random = np.random.default_rng(7)
    model = random.uniform(-1, 1, (12, 3)) * [100, 10, 1]
    apart = []
    for _ in range(100):
        world = model + random.normal(size=model.shape) * 0.5
        found = robust_similarity(model, world, up=UP)
        apart.append(Rotation.from_matrix(found.frame.rotation).as_rotvec(degrees=True)[0])
    # About the long axis; up holds to 3 degrees beside what the points say.
    alone = found.turn_sigma
    assert 0.8 < alone < 3
    assert np.std(apart) == pytest.approx(1 / np.hypot(1 / alone, 1 / 3), rel=0.5)


def test_points_count_by_their_covariance() -> None:
    random = np.random.default_rng(9)
    model = random.uniform(-1, 1, (12, 3)) * [50, 50, 5]
    sigmas = np.where(np.arange(12)[:, None] < 6, 0.01, 3.0) * [1, 1, 2]
    world = model + random.normal(size=model.shape) * sigmas
    covariances = np.einsum("ni,ij->nij", sigmas**2, np.eye(3))
    weighted = robust_similarity(model, world, up=UP, covariances=covariances)
    equal = robust_similarity(model, world, up=UP)
    assert weighted.used.all()
    away = [np.abs(one.frame.world(model) - model).max() for one in (weighted, equal)]
    assert away[0] < 0.1 < away[1]


def test_a_given_bound_is_kept() -> None:
    random = np.random.default_rng(11)
    model = random.uniform(-1, 1, (20, 3)) * [50, 50, 5]
    world = model + random.normal(size=model.shape)
    found = robust_similarity(model, world, up=UP, max_residual=2.0)
    away = np.linalg.norm(found.residuals, axis=1)
    np.testing.assert_array_equal(away <= 2.0, found.used)
    assert 3 < found.used.sum() < 20


def test_same_bytes_again() -> None:
    random = np.random.default_rng(13)
    model = random.normal(size=(40, 3))  # more triples than are tried
    world = model + random.normal(size=(40, 3)) * 0.1
    first, second = (robust_similarity(model, world, up=UP) for _ in range(2))
    assert first.frame.rotation.tobytes() == second.frame.rotation.tobytes()
    assert first.residuals.tobytes() == second.residuals.tobytes()
