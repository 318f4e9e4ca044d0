"""The filter on estimates whose right answer is known pixel by pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sirpy import filtering
from sirpy.errors import InputError
from sirpy.filtering import (
    CONFIDENCE,
    Estimate,
    FilterOptions,
    Reason,
    cosines,
    filter_depths,
    first_reasons,
    probability,
)
from sirpy.rectangle import Rectangle

INTRINSICS = np.array([[100.0, 0, 20], [0, 100, 15], [0, 0, 1]])
SOURCES = 9


def facing_plane(height: int = 30, width: int = 40) -> Estimate:
    """A plane at depth 10 that faces the camera; everything speaks for it."""
    shape = (height, width)
    normal = np.zeros((3, *shape), np.float32)
    normal[2] = -1
    return Estimate(
        depth=np.full(shape, 10, np.float32),
        normal=normal,
        cost=np.full(shape, 0.1, np.float32),
        num_seeing=np.full(shape, SOURCES, np.uint8),
        num_consistent=np.full(shape, 8, np.uint8),
        texture=np.full(shape, 200, np.float32),
        sigma=np.full(shape, 0.02, np.float32),
        motion=np.full(shape, 0.1, np.float32),  # as deep as a pixel is wide
        level=np.zeros(shape, np.uint8),
    )


def changed(estimate: Estimate, y: int, x: int, **values: float) -> Estimate:
    """With other values at one pixel."""
    maps = {}
    for name, value in values.items():
        maps[name] = getattr(estimate, name).copy()
        maps[name][..., y, x] = value
    return replace(estimate, **maps)


def filtered(
    estimate: Estimate,
    *,
    window: tuple[int, int] = (0, 0),
    masked: np.ndarray | None = None,
    options: FilterOptions = FilterOptions(),
) -> tuple[np.ndarray, np.ndarray]:
    height, width = estimate.depth.shape
    if masked is None:
        masked = np.zeros((height, width), bool)
    rectangle = Rectangle(*window, width, height)
    return filter_depths(estimate, INTRINSICS, rectangle, masked, options)


def leaning(degrees: float, ray: np.ndarray) -> np.ndarray:
    """A unit normal at an angle to the way back along a ray."""
    back = -ray / np.linalg.norm(ray)
    across = np.cross(back, [0, 1, 0])
    across /= np.linalg.norm(across)
    return np.cos(np.radians(degrees)) * back + np.sin(np.radians(degrees)) * across


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({}, 0),
        # What nothing sees lacks no agreement: as many are needed as see a place.
        ({"num_seeing": 0, "num_consistent": 0}, Reason.NOT_SEEN),
        ({"depth": 0}, Reason.NOT_SEEN),
        ({"cost": 0.9, "num_consistent": 4}, Reason.HIGH_COST),
        ({"cost": 0.9, "num_consistent": 5}, 0),
        ({"num_consistent": 1}, Reason.INCONSISTENT),
        ({"num_consistent": 2}, 0),
        ({"num_consistent": 1, "num_seeing": 1}, 0),  # no more can agree
        ({"num_consistent": 0, "num_seeing": 1}, Reason.INCONSISTENT),
        ({"texture": 0, "num_consistent": 3}, 0),  # the deviation says what texture is worth
        ({"cost": 0.9, "num_consistent": 1}, Reason.HIGH_COST | Reason.INCONSISTENT),
        ({"sigma": 9.9}, 0),  # of 10, a hundred units
        ({"sigma": 10.1}, Reason.UNSURE),
        ({"sigma": 10.1, "motion": 0.2}, 0),
        ({"sigma": 10.1, "motion": 0.01}, Reason.UNSURE),  # a pixel's worth is 0.1
    ],
)
def test_each_reason(values: dict[str, float], reason: int) -> None:
    options = FilterOptions(min_confidence=0)
    found, confidence = filtered(changed(facing_plane(), 12, 17, **values), options=options)
    expected = np.zeros((30, 40), np.uint8)
    expected[12, 17] = reason
    np.testing.assert_array_equal(found, expected)
    assert ((confidence > 0) == (found == 0)).all()
    assert (confidence <= 1).all()


def test_what_is_too_seldom_right_is_unsure() -> None:
    estimate = changed(facing_plane(), 12, 17, num_consistent=2, num_seeing=9, cost=0.7)
    everything = filtered(estimate, options=FilterOptions(min_confidence=0))[1]
    weakest = float(everything[12, 17])
    assert weakest < everything[everything != everything[12, 17]].min()
    for least, reason in ((weakest - 1e-3, 0), (weakest + 1e-3, Reason.UNSURE)):
        found, confidence = filtered(estimate, options=FilterOptions(min_confidence=least))
        assert found[12, 17] == reason
        assert (np.delete(found, 12 * 40 + 17) == 0).all()
        assert (confidence[12, 17] > 0) == (reason == 0)


def test_masked_pixels_have_no_depth() -> None:
    masked = np.zeros((30, 40), bool)
    masked[:, :11] = True
    reason, _ = filtered(facing_plane(), masked=masked)
    np.testing.assert_array_equal(reason, masked * np.uint8(Reason.MASKED))


def test_a_surface_seen_nearly_edge_on_is_left_out() -> None:
    window = (300, -80)  # the ray counts, not the viewing direction
    ray = np.array([(300 + 17.5 - 20) / 100, (-80 + 12.5 - 15) / 100, 1])
    options = FilterOptions(max_angle=80, speckle_pixels=0, min_confidence=0)
    for degrees, reason in ((79.5, 0), (80.5, Reason.GRAZING)):
        estimate = changed(facing_plane(), 12, 17, normal=leaning(degrees, ray))
        rectangle = Rectangle(*window, 40, 30)
        cosine = cosines(estimate.normal, INTRINSICS, rectangle)[12, 17]
        assert cosine == pytest.approx(np.cos(np.radians(degrees)), abs=1e-6)
        assert filtered(estimate, window=window, options=options)[0][12, 17] == reason
        # Half a patch's slope, or 0.4 between sides that are 0.8 apart, is too unsure to be called grazing.
        unsure = changed(estimate, 12, 17, sigma=0.41)
        assert filtered(unsure, window=window, options=options)[0][12, 17] == 0


def test_islands_are_speckles_unless_they_are_large_or_may_go_on() -> None:
    estimate = facing_plane()
    depth = estimate.depth.copy()
    depth[5:9, 5:12] = 11  # 28 pixels
    depth[15:20, 20:26] = 11  # 30
    depth[20:30, 35:37] = 11  # 20, on the border
    depth[1:3, 20:24] = 11  # 8, half of them confirmed by three sources
    agreeing = np.full_like(estimate.num_consistent, 2)
    agreeing[1] = 3
    estimate = replace(estimate, depth=depth, num_consistent=agreeing)
    options = FilterOptions(speckle_pixels=30, speckle_consistent=3, min_confidence=0)
    reason, _ = filtered(estimate, options=options)
    expected = np.zeros_like(reason)
    expected[5:9, 5:12] = Reason.SPECKLE
    expected[2, 20:24] = Reason.SPECKLE
    np.testing.assert_array_equal(reason, expected)
    # The step of 1 is within three deviations of the difference, 1.06.
    unsure = replace(estimate, sigma=np.full_like(estimate.sigma, 0.25))
    assert (filtered(unsure, options=options)[0] == 0).all()


@given(seed=st.integers(0, 1000), x0=st.integers(0, 50), y0=st.integers(0, 28))
def test_what_is_kept_does_not_depend_on_the_window(seed: int, x0: int, y0: int) -> None:
    """Every pixel at least the margin from the border; in any bands of rows."""
    options = FilterOptions(speckle_pixels=12, speckle_consistent=33, min_confidence=0.2)
    margin = options.margin
    whole = random_estimate(seed)
    rectangle = Rectangle(x0, y0, 60, 52)
    rows, columns = rectangle.slices_in(Rectangle(0, 0, 110, 80))
    part = Estimate(
        *(
            np.ascontiguousarray(getattr(whole, name)[..., rows, columns])
            for name in Estimate.__dataclass_fields__
        )
    )
    inner = (slice(margin, -margin), slice(margin, -margin))
    of_whole = [plane[rows, columns][inner] for plane in filtered(whole, options=options)]
    of_part = [plane[inner] for plane in filtered(part, window=(x0, y0), options=options)]
    assert 0 < (of_whole[0] == Reason.SPECKLE).mean() < 0.9
    for a, b in zip(of_whole, of_part, strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(filtering, "_BAND_PIXELS", 60 * 7)
        of_bands = filtered(part, window=(x0, y0), options=options)
    for a, b in zip(of_part, of_bands, strict=True):
        np.testing.assert_array_equal(a, b[inner])


def random_estimate(seed: int) -> Estimate:
    """Islands of three depths, and everything else at random."""
    random = np.random.default_rng(seed)
    shape = (80, 110)
    normal = random.normal(0, 0.1, (3, *shape)) - np.array([0, 0, 1])[:, None, None]
    seeing = random.integers(1, SOURCES + 1, shape)
    return Estimate(
        depth=random.choice([10, 12, 14], (27, 37))
        .repeat(3, 0)
        .repeat(3, 1)[:80, :110]
        .astype("f4"),
        normal=(normal / np.linalg.norm(normal, axis=0)).astype(np.float32),
        cost=random.uniform(0, 0.65, shape).astype(np.float32),
        num_seeing=seeing.astype(np.uint8),
        num_consistent=np.clip(seeing - random.integers(0, 2, shape), 0, None).astype(np.uint8),
        texture=random.uniform(0, 300, shape).astype(np.float32),
        sigma=random.choice([0, 0.01, 0.1, 0.5], (9, 12))
        .repeat(9, 0)
        .repeat(10, 1)[:80, :110]
        .astype("f4"),
        motion=random.choice([0, 0.05, 0.2], shape).astype(np.float32),
        level=random.integers(0, 3, shape).astype(np.uint8),
    )


def test_what_speaks_against_a_depth_makes_it_less_sure() -> None:
    best = filtered(facing_plane())[1][12, 17]
    assert 0.98 < best < 1
    for values in ({"num_consistent": 4}, {"cost": 0.4}, {"texture": 3000}):
        assert filtered(changed(facing_plane(), 12, 17, **values))[1][12, 17] < best
    estimate = facing_plane()
    depth = estimate.depth.copy()
    depth[:, 20:] = 11
    beside_an_edge = filtered(replace(estimate, depth=depth))[1]
    assert (beside_an_edge[10, [16, 23]] < best - 0.005).all()
    # Farther off there are only deviations in another unit, a little.
    np.testing.assert_allclose(beside_an_edge[10, [15, 24]], best, atol=2e-3)
    unsure = replace(facing_plane(), sigma=np.full((30, 40), 0.5, np.float32))
    assert filtered(unsure)[1][12, 17] < best


def test_confidence_is_the_logistic_function_of_the_evidence() -> None:
    evidence = np.zeros((len(CONFIDENCE), 1, 3), np.float32)
    evidence[0] = 1
    coefficients = np.zeros(len(CONFIDENCE))
    coefficients[:2] = -1, 0.5
    evidence[1] = [[0, 2, 10]]
    expected = [[1 / (1 + np.e), 0.5, 1 / (1 + np.exp(-4))]]
    np.testing.assert_allclose(probability(evidence, coefficients), expected, rtol=1e-6)


def test_the_first_reason_of_several() -> None:
    reason = np.array([0, 1, 6, 192, 255, 128], np.uint8)
    np.testing.assert_array_equal(first_reasons(reason), [0, 1, 2, 64, 1, 128])


def test_options_out_of_range_are_named() -> None:
    with pytest.raises(InputError, match=r"^max_angle = 91 is not possible: choose 1 to 90"):
        FilterOptions(max_angle=91)
    with pytest.raises(InputError, match="speckle_pixels = -1"):
        FilterOptions(speckle_pixels=-1)
