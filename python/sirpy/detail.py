"""What a photograph carries: its noise, and the finest detail that is more than noise.

Photographs carry less than their pixels say: sensors have noise, lenses and demosaicing blur, JPEG drops weak detail
and leaves blocks. Both are estimated from windows spread over the photograph, in grey levels of 8 bit; pixels of
level l are means of 2^l x 2^l native ones. Brightness is in 16 bins of 16 grey levels.

Noise is measured where there is least of everything else (Ponomarenko et al., "An automatic approach to lossy
compression of AVIRIS images", 2007): in blocks of 8 x 8 pixels less their ramp, split by Haar's transform into three
octaves. A block is chosen by its neighbours, not by itself, so that the choice does not favour low noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.rectangle import Rectangle

LEVELS, BINS = 7, 16
_WINDOW, _MOST_WINDOWS = 512, 24  # side in pixels: memory and time do not grow with the photograph
_BLOCK = 8
_OFFSET = 4  # blocks of JPEG end inside those of the estimate, so that steps between them are noise
_LEAST_BLOCKS, _QUIETEST = 8, 0.01  # of each brightness: a number, or a share if that is more
_STEEPEST = 1.3  # of noise, from one brightness to the next
_QUANTISATION = 1 / 12  # variance of rounding to whole grey levels
_PATCH, _PER_OCTAVE, _OCTAVES = 32, 4, 6  # of spectra: side in pixels, frequencies
_SHARE = 0.75  # detail counts that a quarter of the patches exceed
_MOST_DROP = 0.8 * np.log(10)  # 8 dB an octave, where sharp photographs of anything lose up to 6

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]


@dataclass(frozen=True)
class Detail:
    """What a photograph carries."""

    noise: Floats
    """Variance of the noise in squared grey levels, (7, 16), by level and brightness."""
    resolution: float
    """Native pixels, at least 1: the finest detail that is more than noise, about the full width at half maximum of
    what a point becomes."""


def measure_detail(
    read: Callable[[Rectangle], NDArray[np.uint8]], width: int, height: int
) -> Detail:
    """Estimates noise and resolution of a photograph of `width` x `height` pixels.

    Args:
        read: gives the grey levels, (height, width), of a rectangle of native pixels; it is asked for those of
            `sample_windows`, in that order.
    """
    windows = [np.ascontiguousarray(read(one)) for one in sample_windows(width, height)]
    noise = _noise(windows)
    return Detail(noise, _resolution(windows, noise))


def sample_windows(width: int, height: int) -> list[Rectangle]:
    """At most 24 squares of 512 pixels, evenly spread, row by row; all of a smaller side."""
    even = round((_MOST_WINDOWS * width / height) ** 0.5)
    across = max(1, min(even, _MOST_WINDOWS, width // _WINDOW))
    down = max(1, min(_MOST_WINDOWS // across, height // _WINDOW))
    wide, high = min(_WINDOW, width), min(_WINDOW, height)
    # Multiples of 8: where blocks of JPEG begin.
    xs = [(2 * i + 1) * width // (2 * across) - wide // 2 & ~7 for i in range(across)]
    ys = [(2 * i + 1) * height // (2 * down) - high // 2 & ~7 for i in range(down)]
    return [Rectangle(x, y, wide, high) for y in ys for x in xs]


# ---- noise


def _noise(windows: list[NDArray[np.uint8]]) -> Floats:
    """(levels, brightness), from the quietest blocks; where a brightness has too few, from the nearest that do."""
    mean, octaves, around = (
        np.concatenate(parts, axis=-1) for parts in zip(*map(_blocks, windows), strict=True)
    )
    found = np.full((3, BINS), np.nan)
    for one in range(BINS):
        members = np.flatnonzero(mean.astype(np.intp) * BINS // 256 == one)
        if len(members) >= _LEAST_BLOCKS:
            count = max(_LEAST_BLOCKS, int(_QUIETEST * len(members)))
            chosen = members[np.argsort(around[members], kind="stable")[:count]]
            found[:, one] = _variances(octaves[:, chosen])
    known = np.flatnonzero(~np.isnan(found[0]))
    if len(known) == 0:
        return np.full((LEVELS, BINS), _QUANTISATION, np.float32)
    # Of the noise of sensors, no brightness has many times that of the next: the rest is texture.
    growth = _STEEPEST ** np.abs(known[:, None] - known)
    least = (np.maximum(found[:, known], 1e-6)[:, None] * growth).min(axis=2)
    smooth = [np.interp(np.arange(BINS), known, np.log(row)) for row in least]
    levels = list(np.exp(smooth))
    # Neither demosaicing nor blocks of JPEG correlate noise much beyond 8 pixels.
    while len(levels) < LEVELS:
        levels.append(levels[-1] / 4)
    noise: Floats = np.maximum(np.stack(levels), _QUANTISATION).astype(np.float32)
    return noise


def _variances(octaves: Floats) -> Doubles:
    """Of pixels of levels 0, 1 and 2, from the power of three octaves in some blocks, (3, n)."""
    total = 48 * octaves[0] + 12 * octaves[1] + 4 * octaves[2]
    fine, middle, coarse = octaves[:, total <= 3 * np.median(total)].mean(axis=1)
    # Ramps took the lowest frequencies of the coarsest octave: the spectrum goes on as it does from the one before.
    coarse *= np.clip(coarse / max(middle, 1e-6), 1, 2) ** np.float32(2 / 3)
    sums = 48 * fine + 12 * middle + 4 * coarse, 12 * middle + 4 * coarse, 4 * coarse
    return np.array(sums) / 64


def _blocks(window: NDArray[np.uint8]) -> tuple[Floats, Floats, Floats]:
    """Of the n blocks of a window: mean grey (n,); power of a Haar coefficient by octave, finest first, (3, n), less
    that of the ramp; and the largest variance of the blocks around, (n,).

    Blocks that are constant or saturated have no noise to see, and are left out.
    """
    rows, columns = (max(0, (side - _OFFSET) // _BLOCK) for side in window.shape)
    inside = window[_OFFSET : _OFFSET + rows * _BLOCK, _OFFSET : _OFFSET + columns * _BLOCK]
    blocks = inside.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2)
    if blocks.size == 0:
        return np.zeros(0, np.float32), np.zeros((3, 0), np.float32), np.zeros(0, np.float32)
    darkest, brightest = blocks.min(axis=(2, 3)), blocks.max(axis=(2, 3))
    usable = (darkest < brightest) & (darkest > 0) & (brightest < 255)
    mean = blocks.mean(axis=(2, 3), dtype=np.float32)
    pixels = blocks - mean[..., None, None]
    ramp = (np.arange(_BLOCK, dtype=np.float32) - 3.5) / np.float32(42**0.5)
    pixels -= (pixels.mean(axis=2) @ ramp)[..., None, None] * ramp
    pixels -= (pixels.mean(axis=3) @ ramp)[..., None, None] * ramp[:, None]
    variance = np.square(pixels).sum(axis=(2, 3)) / 61
    octaves = []
    # Haar coefficients in each octave, without what is lost with the ramp.
    for count in (48 - 2 / 21, 12 - 8 / 21, 3 - 32 / 21):
        side = pixels.shape[-1] // 2
        cells = pixels.reshape(rows, columns, side, 2, side, 2)
        means = cells.sum(axis=(3, 5)) / 2
        details = np.square(pixels).sum(axis=(2, 3)) - np.square(means).sum(axis=(2, 3))
        octaves.append(details / np.float32(count))
        pixels = means
    padded = np.pad(variance, 1, mode="edge")
    around = [
        padded[y : y + rows, x : x + columns] for y, x in np.ndindex(3, 3) if (y, x) != (1, 1)
    ]
    return mean[usable], np.stack(octaves)[:, usable], np.max(around, axis=0)[usable]


# ---- resolution


def _resolution(windows: list[NDArray[np.uint8]], noise: Floats) -> float:
    """Native pixels: half the wavelength down to which every octave of detail is twice the noise, and not far less
    than scenes have."""
    frequency, power = _spectrum(windows)
    if len(power) <= 2 * _PER_OCTAVE:
        return 1.0
    # What compression and smoothing take from the finest detail was noise in level 2: taken as white.
    share = np.sum([np.bincount(one.ravel() >> 4, minlength=BINS) for one in windows], axis=0)
    floor = 16 * float(noise[2] @ share / share.sum())
    # Power of scenes falls with the square of the frequency; around an octave below, so that rows of crops, all of one
    # width, do not make what is finer look lost.
    signal = np.log(np.maximum(power - floor, 1e-6) * frequency**2)
    coarser = np.convolve(signal, np.full(5, 0.2), "valid")[_PER_OCTAVE // 2 :]
    clear = np.log(power / (2 * floor))
    margin = np.minimum(signal[: len(coarser)] - coarser + _MOST_DROP, clear[: len(coarser)])
    lost = np.flatnonzero(margin < 0)
    if len(lost) == 0:
        return 1.0
    at = int(lost[-1])  # the coarsest that is lost; between it and the next is the limit
    step = margin[at] / (margin[at] - margin[at + 1]) if at + 1 < len(margin) else 0.0
    return max(1.0, float(0.5 / frequency[at] * 2 ** (step / _PER_OCTAVE)))


def _spectrum(windows: list[NDArray[np.uint8]]) -> tuple[Doubles, Doubles]:
    """Frequencies in cycles per native pixel, finest first, and the power of detail there, as the variance of native
    pixels that white noise of that power has."""
    taper = np.hanning(_PATCH + 2)[1:-1].astype(np.float32)
    taper /= np.sqrt(np.square(taper).mean())
    radius = np.hypot(np.fft.fftfreq(_PATCH)[:, None], np.fft.rfftfreq(_PATCH))
    octave = np.floor(-_PER_OCTAVE * (1 + np.log2(np.maximum(radius, 1e-3)))).astype(np.intp)
    powers = []
    for level in range(_OCTAVES - 1):
        patches = [
            _patches(_core.shrunk(one, 1 << level))
            for one in windows
            if min(one.shape) >= _PATCH << level
        ]
        if not patches:
            break
        squares = np.concatenate(patches)
        squares -= squares.mean(axis=(1, 2), keepdims=True)
        spectra = np.square(np.abs(np.fft.rfft2(squares * taper * taper[:, None]))) / _PATCH**2
        # The finest octave of a coarser level is aliased: it is taken from the finer one.
        first = 0 if level == 0 else _PER_OCTAVE
        for index in range(first, 2 * _PER_OCTAVE):
            there = spectra[:, octave == index].mean(axis=1)
            powers.append(4**level * max(np.quantile(there, _SHARE), 1e-6))
    frequency = 2 ** (-1 - (np.arange(len(powers)) + 0.5) / _PER_OCTAVE)
    return frequency, np.array(powers)


def _patches(window: NDArray[np.uint8]) -> Floats:
    """Squares side by side, (n, side, side)."""
    rows, columns = (side // _PATCH for side in window.shape)
    inside = window[: rows * _PATCH, : columns * _PATCH].astype(np.float32)
    return inside.reshape(rows, _PATCH, columns, _PATCH).swapaxes(1, 2).reshape(-1, _PATCH, _PATCH)
