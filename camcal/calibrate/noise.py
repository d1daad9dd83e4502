"""How far corners are off for no reason that is modelled: of all views, of one view, of a single corner.

A corner's weight falls smoothly where its residual is beyond four standard deviations, 1 / (1 + (d² / 16)³); a view's
where its corners are 16 times as noisy as those of a typical view. Both are taken anew in every pass.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.outliers import RAYLEIGH_MEDIAN

REJECTED = 1 / 3  # a corner of a smaller weight is listed as rejected: 4 of 100 000 Gaussian ones, beyond 4.5 σ
_CUT = 16.0  # d² at which a corner has half its weight
_VIEW_DOF = 20.0  # degrees of freedom of the prior by which a view's noise is that of all
_VIEW_CUT = 256.0  # times the typical variance, at which a view has half its weight
FINEST = 1e-4  # px; noise-free input must not be judged by its rounding errors
_LEAST_DOF = 0.05  # of a view's coordinates, however many parameters it has paid for
_LONGEST, _LEAST_SHARE = 4.0, 0.8  # standard deviations by the median of residuals
_ALTERNATIONS = 30  # between the noise of all and that of each view
_NOISIEST = 1e3  # times the typical noise: what a view's is taken to be at most
_LOST = 0.5  # of its corners' weights: a view with less has lost most of them
_FAR = 1e6  # d² beyond which a weight is 0


@dataclass(frozen=True, eq=False)
class ViewNoise:
    """sigma: standard deviation, px, of a coordinate of a typical corner of a typical view. views: (V,) the variance of
    a view's corners over that.
    """

    sigma: float
    views: Array


def median_limit(noise: ViewNoise) -> float:
    """Return the median length, px, of a view's residuals beyond which all of its corners are rejected."""
    return float(noise.sigma * np.sqrt(_VIEW_CUT * (1 / REJECTED - 1) ** (1 / 3)) * RAYLEIGH_MEDIAN)


def _weight(squared: Array) -> Array:
    return np.asarray(1 / (1 + (squared / _CUT) ** 3))


# of d² = x² + y² with standard normal x and y, whose half has an exponential distribution
_NODES, _SHARES = np.polynomial.laguerre.laggauss(60)
_MEAN_WEIGHT = float(_SHARES @ _weight(2 * _NODES))
_WEIGHTED_SQUARES = float(_SHARES @ (_weight(2 * _NODES) * _NODES))


def first_noise(distances: Array, present: Array) -> ViewNoise:
    """Return the noise by the medians of the residuals' lengths (V, P): half of a view's corners may be anything."""
    typical = max(float(np.median(_medians(distances, present))), FINEST)
    return ViewNoise(typical, _by_medians(distances, present, typical))


def count_of(weights: Array) -> Array:
    """Return how many coordinates (V,) count by the weights (V, P): those of Gaussian corners, all of them in full."""
    return np.asarray(2 * weights.sum(axis=1) / _MEAN_WEIGHT)


def clipped(residuals: Array) -> Array:
    """Return residuals (N, 2) with those much longer than the others cut to the length that few Gaussian ones have."""
    lengths = np.hypot(*residuals.T)
    longest = _LONGEST * float(np.median(lengths)) / RAYLEIGH_MEDIAN if len(lengths) else 0.0
    return np.asarray(residuals * np.minimum(1, longest / np.maximum(lengths, 1e-300))[:, None])


def view_noise(
    distances: Array,
    present: Array,
    weights: Array,
    spent: Array,
    noise: ViewNoise,
    share: float = 1.0,
    finest: float = FINEST,
) -> ViewNoise:
    """Return the noise by weighted residuals (V, P) px, a share of the way from the noise of before in logarithms.

    spent: (V,) degrees of freedom that parameters have taken. finest: px, the least noise that corners may have.
    """
    weights = np.where(np.isnan(distances), 0.0, weights)  # the lens of now may not take what that of before took
    squares = np.sum(weights * np.where(weights > 0, distances, 0.0) ** 2, axis=1) / _WEIGHTED_SQUARES
    count = count_of(weights)
    dof = np.maximum(count - spent, _LEAST_DOF * count)
    even = np.nan_to_num(distances, nan=np.inf) / np.sqrt(noise.views)[:, None]
    # weights follow from the noise: without a bound by the median of all corners both could shrink each other
    least = max(_LEAST_SHARE * float(np.median(even[present])) / RAYLEIGH_MEDIAN, finest) ** 2
    variance, views = noise.sigma**2, noise.views
    for _ in range(_ALTERNATIONS):
        trusted = _view_weight(views)
        variance = max(float(np.sum(trusted * squares / views) / np.sum(trusted * dof)), least)
        views = (_VIEW_DOF + squares / variance) / (_VIEW_DOF + dof)
    sigma = noise.sigma ** (1 - share) * variance ** (share / 2)
    views = noise.views ** (1 - share) * views**share
    # what counts for little says nothing of its noise: all its corners do, by their median
    little = lost(weights, present)
    return ViewNoise(float(sigma), np.where(little, _by_medians(distances, present, float(sigma)), views))


def lost(weights: Array, present: Array) -> Array:
    """Return which views (V,) have lost most of their corners, weights (V, P)."""
    return np.asarray(weights.sum(axis=1) < _LOST * present.sum(axis=1))


def _by_medians(distances: Array, present: Array, sigma: float) -> Array:
    """Return the variances (V,) of views over sigma² by the median of their residuals (V, P), at least 1."""
    return np.asarray(np.clip(_medians(distances, present) / sigma, 1.0, _NOISIEST) ** 2)


def _medians(distances: Array, present: Array) -> Array:
    """Return the standard deviation (V,) of each view's coordinates by the median of its residuals (V, P)."""
    ordered = np.sort(np.where(present, np.nan_to_num(distances, nan=np.inf), np.inf), axis=1)
    middle = np.maximum(present.sum(axis=1) - 1, 0) // 2
    return np.asarray(np.take_along_axis(ordered, middle[:, None], axis=1)[:, 0] / RAYLEIGH_MEDIAN)


def corner_weights(distances: Array, present: Array, noise: ViewNoise, spent: Array) -> Array:
    """Return the weights (V, P) of corners, that of their view included."""
    count = 2 * present.sum(axis=1)
    left = np.maximum(1 - spent / np.maximum(count, 1), _LEAST_DOF)
    squared = np.nan_to_num(distances, nan=np.inf) ** 2 / (noise.sigma**2 * noise.views * left)[:, None]
    weights = np.where(present & (squared < _FAR), _weight(np.minimum(squared, _FAR)), 0.0)
    return np.asarray(weights * _view_weight(noise.views)[:, None])


def _view_weight(variances: Array) -> Array:
    return np.asarray(1 / (1 + (variances / _VIEW_CUT) ** 3))
