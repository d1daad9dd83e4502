"""Whether both cameras of a pair were given the same light: the counts of what both images show."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.stereo.pair.alignment import Measured, Residual

_WINDOW = 2  # px about a feature; a mean over 5x5 is little moved by a quarter of a pixel
_ENDS = (4, 251)  # counts; beyond them pixels may be cut off
_FEWEST = 20
_GAMMAS = np.geomspace(0.4, 2.5, 61)  # steps of 3 %
_ROUNDS = 10
_BREAK = 4.685  # deviations, for Tukey's biweight: what shines, or is in another's shadow, is left out
_NORMAL = 1.4826
_LEAST_SCATTER = 0.5  # counts
_SURE = 3.0
_LEAST_SPREAD = 1e-6  # counts²; images of one gray tell no gain
_NOTICEABLE = 0.05  # of the light


@dataclass(frozen=True)
class Exposure:
    """How the right image's counts come from the left one's: gain · 255 · (left / 255)^gamma + offset.

    brightness: by how much the right image is brighter, 0.1 for 10 %. scatter: counts about the curve.
    """

    brightness: Measured
    gain: float
    offset: float
    gamma: float
    scatter: float

    @property
    def differs(self) -> bool:
        """Whether the difference is no chance and worth a word."""
        value, std = self.brightness
        return abs(value) > max(_NOTICEABLE, _SURE * std)


def exposure_of(left: Array, right: Array, residual: Residual) -> Exposure | None:
    """Return how the exposures of a pair differ; None where too few features lie between black and white.

    left, right: (H, W) uint8.
    """
    windows = _windows(left, residual.pixels), _windows(right, residual.partners)
    whole = np.logical_and(*((_ENDS[0] < part.min(axis=1)) & (part.max(axis=1) < _ENDS[1]) for part in windows))
    if whole.sum() < _FEWEST:
        return None
    first, second = (part[whole].mean(axis=1) for part in windows)
    fits = [_fit(first, second, gamma) for gamma in _GAMMAS]
    best = int(np.argmin([scatter for _, scatter, _ in fits]))
    (gain, offset), scatter, weights = fits[best]
    kept = weights > 0
    return Exposure(_brightness(first[kept], second[kept]), gain, offset, float(_GAMMAS[best]), scatter)


def _windows(gray: Array, pixels: Array) -> Array:
    """Return the counts (N, 25) of the windows about pixels (N, 2)."""
    columns, rows = np.rint(pixels).astype(int).T
    steps = np.arange(-_WINDOW, _WINDOW + 1)
    height, width = gray.shape
    down = np.clip(rows[:, None] + steps, 0, height - 1)
    across = np.clip(columns[:, None] + steps, 0, width - 1)
    return np.asarray(gray[down[:, :, None], across[:, None, :]].reshape(len(pixels), -1))


def _fit(first: Array, second: Array, gamma: float) -> tuple[tuple[float, float], float, Array]:
    """Return gain and offset for a gamma, the scatter about the curve, counts, and the weights (N,)."""
    curve = 255 * (first / 255) ** gamma
    weights = np.ones_like(first)
    for _ in range(_ROUNDS):
        share = weights / weights.sum()
        middle, level = share @ curve, share @ second
        gain = (share * (curve - middle)) @ (second - level) / max(share @ (curve - middle) ** 2, _LEAST_SPREAD)
        offset = level - gain * middle
        off = np.abs(second - gain * curve - offset)
        scatter = max(_NORMAL * float(np.median(off)), _LEAST_SCATTER)
        weights = np.maximum(1 - (off / (_BREAK * scatter)) ** 2, 0) ** 2
    return (float(gain), float(offset)), scatter, weights


def _brightness(first: Array, second: Array) -> Measured:
    """Return the ratio of the light in both, less 1."""
    ratio = float(second.mean() / first.mean())
    std = float(np.std(second - ratio * first) / (np.sqrt(len(first)) * first.mean()))
    return Measured(ratio - 1, std)
