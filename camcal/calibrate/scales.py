"""How large a class of effects is: its scale under a prior of which half says that there is nothing at all.

k coefficients x ~ N(0, τ² I) of which the data say N(Λ⁻¹ g, Λ⁻¹). The scale τ is 0 with probability ½, else log-normal.
Averaged over what the data leave of τ, each coefficient shrinks continuously from the data's value towards zero;
nothing is kept or dropped by a test of significance. The averaged shrinkage is that of one effective scale, which is
the prior under which the coefficients are then estimated.
Source: Mitchell & Beauchamp 1988 (spike and slab); MacKay 1992 (evidence of a scale).
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

_POINTS, _REACH = 65, 4.0  # of the grid of scales, and how many standard deviations of their logarithm it holds
_WITHIN = np.linspace(-_REACH, _REACH, _POINTS)
# logarithms of τ over the median, among which the effective scale is looked for, and in how many parts of each step
_COARSE, _PARTS = np.linspace(-14.0, 6.0, 21), 20


@dataclass(frozen=True)
class Scale:
    """effective: the scale whose shrinkage is the averaged one. mean, std: of the scale itself, given the data.
    present: the probability that there is anything at all.
    """

    effective: float
    mean: float
    std: float
    present: float


def scale_of(information: Array, vector: Array, median: float, spread: float) -> Scale:
    """Return the scale of k coefficients.

    information: Λ (k, k) or, where coefficients are independent, its diagonal (k,). vector: g (k,). median, spread: of
    the log-normal distribution.
    """
    if information.ndim == 2:
        values, vectors = np.linalg.eigh(information)
        vector = vectors.T @ vector
    else:
        values = information
    values = np.maximum(values, 1e-300)
    scales = median * np.exp(spread * _WITHIN)
    weights = np.exp(-0.5 * _WITHIN**2)
    weights /= weights.sum()
    evidence = _evidence(values, vector, scales)
    top = max(float(evidence.max()), 0.0)
    slab = weights * np.exp(evidence - top)
    spike = np.exp(-top)
    share = slab / (slab.sum() + spike)
    present = float(share.sum())
    mean = float(share @ scales)
    std = float(np.sqrt(max(share @ scales**2 - mean**2, 0.0)))
    length = float(np.linalg.norm(vector))
    direction = vector / length if length > 0 else np.ones_like(vector)  # shrinkage does not depend on the length
    wanted = float(np.sum(values * (_estimates(values, direction, scales) @ share) ** 2))
    reached = _fitted(values, direction, median * np.exp(_COARSE))
    step = int(np.clip(np.searchsorted(reached, wanted), 1, len(_COARSE) - 1))
    trial = median * np.exp(np.linspace(_COARSE[step - 1], _COARSE[step], _PARTS + 1))
    reached = np.maximum(_fitted(values, direction, trial), 1e-300)
    effective = np.interp(np.log(max(wanted, 1e-300)), np.log(reached), np.log(trial))
    return Scale(float(np.exp(effective)), mean, std, present)


def _evidence(values: Array, vector: Array, scales: Array) -> Array:
    """Return the log likelihood of scales (n,) against no effect."""
    squared = scales**2 * values[:, None]
    return np.asarray(0.5 * np.sum(vector[:, None] ** 2 * scales**2 / (1 + squared) - np.log1p(squared), axis=0))


def _fitted(values: Array, vector: Array, scales: Array) -> Array:
    """Return the squares (n,) that the estimates under scales (n,) take from the data; they grow with the scale."""
    return np.asarray(np.sum(values[:, None] * _estimates(values, vector, scales) ** 2, axis=0))


def _estimates(values: Array, vector: Array, scales: Array) -> Array:
    """Return the coefficients (k, n) under scales (n,)."""
    return np.asarray(vector[:, None] * scales**2 / (1 + scales**2 * values[:, None]))
