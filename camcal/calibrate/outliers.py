"""Which corners cannot be measurements of this board through this lens: a rule on the median, not on the mean."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

CUT = 4.5  # in σ: 4 of 100 000 clean corners are lost
_VIEW_CUT = 4.0  # a view whose median error is this many times the typical view's
_FINEST = 1e-3  # px; noise-free input must not be judged by its rounding errors
_RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))


@dataclass(frozen=True, eq=False)
class Screening:
    """The noise σ of a pixel coordinate, and which points (V, P) are kept."""

    sigma: float
    kept: Array


def robust_sigma(distances: Array, present: Array, freedom: float = 1.0) -> float:
    """Return σ per coordinate from the median of distances (V, P) of present points.

    freedom: degrees of freedom per coordinate, < 1 as fitted residuals are too small. Distances of two Gaussian
    coordinates have the median σ √(2 ln 2).
    """
    values = distances[present]
    median = float(np.median(np.where(np.isnan(values), np.inf, values))) if len(values) else 0.0
    return max(float(median / _RAYLEIGH_MEDIAN / np.sqrt(freedom)), _FINEST)


def screen(distances: Array, present: Array, freedom: float) -> Screening:
    """Return the noise and the kept points, given the residual lengths (V, P) of all points in whitened pixels.

    Points beyond CUT σ go (NaN: outside the lens's domain); views that lose half their points, or whose median
    error is far above that of the others, go whole.
    """
    sigma = robust_sigma(distances, present, freedom)
    kept = present & (np.nan_to_num(distances, nan=np.inf) <= CUT * sigma)
    counts = present.sum(axis=1)
    ordered = np.sort(np.where(present, np.nan_to_num(distances, nan=np.inf), np.inf), axis=1)
    medians = np.take_along_axis(ordered, np.maximum(counts - 1, 0)[:, None] // 2, axis=1)[:, 0]
    bad = (kept.sum(axis=1) * 2 < counts) | (medians > _VIEW_CUT * np.median(medians[counts > 0]))
    return Screening(sigma, kept & ~bad[:, None])


def truncation(cut: float = CUT) -> float:
    """Return the share of the variance that is left of two Gaussian coordinates whose distance is cut at `cut` σ."""
    tail = np.exp(-(cut**2) / 2)
    return float(1 - cut**2 / 2 * tail / (1 - tail))
