"""Noise of a photograph, by brightness and pyramid level.

It is measured where there is least of everything else (as in Ponomarenko et al., "An automatic approach to lossy
compression of AVIRIS images", 2007): in the quietest blocks of 8 x 8 pixels, less their ramp. Haar's transform splits
them into three octaves, so that noise which is correlated is known at coarser levels too. A block is chosen by the
blocks around, not by itself: the choice does not favour low noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEVELS, BINS = (
    8,
    16,
)  # as many as stereo has (view_windows.MOST_LEVEL); of brightness: 16 grey levels each
_BLOCK = 8
_OFFSET = 4  # blocks of JPEG end inside those of the estimate, so that steps between them are noise
_LEAST_BLOCKS, _QUIETEST = 8, 0.01  # of each brightness: a number, or a share if that is more
_STEEPEST = 1.3  # of noise, from one brightness to the next
_QUANTISATION = 1 / 12  # variance of rounding to whole grey levels

Grey = NDArray[np.uint8]
Floats = NDArray[np.float32]


def measure_noise(windows: list[Grey]) -> Floats:
    """Variance in squared grey levels, (8, 16), by level and brightness; at least that of rounding.

    A brightness with too few blocks gets what those beside it have. Photographs without any quiet place have texture
    in it: more than the truth.

    Args:
        windows: grey levels, (height, width), of parts of the photograph, from multiples of 8 pixels.
    """
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


def _variances(octaves: Floats) -> NDArray[np.float64]:
    """Of pixels of levels 0, 1 and 2, from the power of three octaves in some blocks, (3, n)."""
    total = 48 * octaves[0] + 12 * octaves[1] + 4 * octaves[2]
    fine, middle, coarse = octaves[:, total <= 3 * np.median(total)].mean(axis=1)
    # Ramps took the lowest frequencies of the coarsest octave: the spectrum goes on as it does from the one before.
    coarse *= np.clip(coarse / max(middle, 1e-6), 1, 2) ** np.float32(2 / 3)
    sums = 48 * fine + 12 * middle + 4 * coarse, 12 * middle + 4 * coarse, 4 * coarse
    return np.array(sums) / 64


def _blocks(window: Grey) -> tuple[Floats, Floats, Floats]:
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
