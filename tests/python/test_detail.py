"""Noise of known variance is found on and beside texture; resolution follows blur."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from sirpy.detail import Detail, measure_detail, sample_windows
from sirpy.rectangle import Rectangle

Image = NDArray[np.float64]


def measure(image: Image) -> Detail:
    grey = np.clip(np.round(image), 0, 255).astype(np.uint8)
    height, width = grey.shape
    whole = Rectangle(0, 0, width, height)
    return measure_detail(lambda one: grey[one.slices_in(whole)], width, height)


def white(side: int, seed: int = 1) -> Image:
    return np.random.default_rng(seed).normal(size=(side, side))


def filtered(image: Image, response: Image) -> Image:
    """With `response` to the frequency in cycles per pixel; the image goes on at its other side."""
    return np.fft.irfft2(np.fft.rfft2(image) * response, image.shape)


def radius(side: int) -> Image:
    return np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side))


def blurred(image: Image, sigma: float) -> Image:
    return filtered(image, np.exp(-2 * (np.pi * sigma * radius(len(image))) ** 2))


def texture(side: int) -> Image:
    """Detail of all sizes, as scenes have, everywhere; sharp to the pixel."""
    found = filtered(white(side), 1 / np.maximum(radius(side), 1 / side))
    return 128 + 25 * found / found.std()


def half_flat(side: int) -> Image:
    found = texture(side)
    found[:, side // 2 :] = 110
    return found


@pytest.mark.parametrize("scene", [half_flat(1024), np.full((1024, 1024), 110.0)])
@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_white_noise_is_found_beside_texture_and_falls_by_4_each_level(
    scene: Image, sigma: float
) -> None:
    noise = measure(scene + sigma * white(len(scene), 2)).noise[:, 110 // 16]
    expected = np.maximum(sigma**2 / 4.0 ** np.arange(8), 1 / 12)
    assert noise == pytest.approx(expected, rel=0.25)


def test_noise_may_depend_on_brightness() -> None:
    ramp = np.linspace(8, 247, 1024)[None].repeat(1024, axis=0)
    noise = measure(ramp + np.sqrt(2 + ramp / 32) * white(1024, 2)).noise[0]
    expected = 2 + (np.arange(16) * 16 + 8) / 32
    assert noise[1:-1] == pytest.approx(expected[1:-1], rel=0.25)


def test_correlated_noise_falls_more_slowly() -> None:
    noise = blurred(white(1024), 0.7)
    noise *= 3 / noise.std()
    means = noise.reshape(512, 2, 512, 2).mean(axis=(1, 3))
    found = measure(half_flat(1024) + noise).noise[:, 110 // 16]
    assert found[0] == pytest.approx(9, rel=0.25)
    assert found[1] == pytest.approx(means.var(), rel=0.25)


def test_resolution_follows_blur() -> None:
    scene = half_flat(1024)
    found = [
        measure(blurred(scene, sigma) + white(1024, 2)).resolution for sigma in (0, 0.5, 1, 1.5, 2)
    ]
    assert found == sorted(found)
    assert found[0] < 1.5
    # About the full width at half maximum, 2.35 sigma.
    assert 1.6 < found[2] < 2.8
    assert 3.2 < found[4] < 5.6


@pytest.mark.parametrize("shape", [(30, 40), (1, 1), (7, 900), (600, 600), (517, 1029)])
@pytest.mark.parametrize("grey", [0, 100, 255])
def test_what_shows_nothing_has_the_noise_of_rounding(shape: tuple[int, int], grey: int) -> None:
    found = measure(np.full(shape, float(grey)))
    assert found.noise == pytest.approx(np.full((8, 16), 1 / 12))
    assert found.resolution >= 1


def test_small_and_saturated_photographs_have_finite_noise() -> None:
    for image in (texture(40)[:30], 128 + 1000 * white(200), texture(300) + 100):
        found = measure(image)
        assert np.isfinite(found.noise).all()
        assert found.noise.min() >= np.float32(1 / 12)
        assert 1 <= found.resolution < 64


@pytest.mark.parametrize("size", [(13470, 8670), (8858, 12996), (40, 30), (513, 4000), (30000, 10)])
def test_windows_are_few_and_inside(size: tuple[int, int]) -> None:
    windows = sample_windows(*size)
    assert 1 <= len(windows) <= 24
    assert all(Rectangle(0, 0, *size).contains(one) for one in windows)
