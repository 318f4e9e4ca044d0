"""The finest detail of a photograph that is more than noise, from its power spectrum.

Spectra of small patches, at several pyramid levels, give the power that a quarter of the patches exceeds, by
frequency. Scenes have power that falls with about the square of the frequency (Field, "Relations between the
statistics of natural images and the response properties of cortical cells", 1987); a lens, a sensor and compression
make it fall faster, down to the noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sirpy import _core
from sirpy.noise import BINS, Floats, Grey

_PATCH, _PER_OCTAVE, _LEVELS = 32, 4, 5  # of spectra: side in pixels, frequencies
_SHARE = 0.75  # of the patches, that have less
_MOST_DROP = 0.8 * np.log(10)  # 8 dB an octave, where sharp photographs of anything lose up to 6

Doubles = NDArray[np.float64]


def measure_resolution(windows: list[Grey], noise: Floats) -> float:
    """Native pixels, at least 1: half the wavelength down to which detail is twice the noise, and falls not much
    faster than that of scenes. With a Gaussian blur it is about the full width at half maximum.

    Args:
        windows: grey levels, (height, width), of parts of the photograph.
        noise: as `measure_noise` finds it.
    """
    frequency, power = _spectrum(windows)
    if len(power) <= 2 * _PER_OCTAVE:
        return 1.0
    # What compression and smoothing take from the finest detail was noise in level 2: taken as white.
    share = np.sum([np.bincount(one.ravel() >> 4, minlength=BINS) for one in windows], axis=0)
    floor = 16 * float(noise[2] @ share / share.sum())
    # Scenes have power that falls with the square of the frequency. Around an octave below: rows of crops, all of one
    # width, must not make what is finer look lost.
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


def _spectrum(windows: list[Grey]) -> tuple[Doubles, Doubles]:
    """Frequencies in cycles per native pixel, finest first, and the power there: in squared grey levels, as the
    variance of native pixels that white noise of that power has."""
    powers: list[float] = []
    for level in range(_LEVELS):
        large = [one for one in windows if min(one.shape) >= _PATCH << level]
        if not large:
            break
        found = np.concatenate([_octaves(_core.shrunk(one, 1 << level)) for one in large])
        # The finest octave of a coarser level is aliased: it is taken from the finer one.
        taken = found if level == 0 else found[:, _PER_OCTAVE:]
        powers += list(4**level * np.quantile(taken, _SHARE, axis=0))
    frequency = 2 ** (-1 - (np.arange(len(powers)) + 0.5) / _PER_OCTAVE)
    return frequency, np.maximum(powers, 1e-6)


def _octaves(window: Grey) -> Floats:
    """Power of the patches of a window in the frequencies of two octaves below 1/2, finest first, (patches, 8)."""
    rows, columns = (side // _PATCH for side in window.shape)
    inside = window[: rows * _PATCH, : columns * _PATCH].astype(np.float32)
    patches = inside.reshape(rows, _PATCH, columns, _PATCH).swapaxes(1, 2)
    patches = patches - patches.mean(axis=(2, 3), keepdims=True)
    taper = np.hanning(_PATCH + 2)[1:-1].astype(np.float32)
    taper /= np.sqrt(np.square(taper).sum())
    power = np.square(np.abs(np.fft.rfft2(patches * taper * taper[:, None])))
    radius = np.hypot(np.fft.fftfreq(_PATCH)[:, None], np.fft.rfftfreq(_PATCH))
    place = np.floor(-_PER_OCTAVE * (1 + np.log2(np.maximum(radius, 1e-3))))
    found = [power[..., place == one].mean(axis=2).ravel() for one in range(2 * _PER_OCTAVE)]
    return np.stack(found, axis=1, dtype=np.float32)
