"""How far corners are off beyond what their images say: a floor common to all, and errors that repeat with the pixels.

The covariance of a corner says what noise and blur leave open. Paper that is not flat, print that is not exact and a
lens model that is not quite right add errors that no image tells of; they are taken to be the same for all corners.
Sampling of a sharp image and interpolation of its colours shift an edge by an error that repeats every one or two
pixels. Along an edge that crosses many pixel columns it averages out; an edge aligned with the columns is shifted as a
whole, and just there the image claims the smallest errors.

The error of corner i in coordinate c has the variance C_icc + f² + Σ_p a_p² s_icp: C is the claimed covariance, s the
share of errors of period p that is left along the corner's edges. The variances f² and a_p² are those of the largest
restricted likelihood of a calibration's residuals.
Source: Patterson & Thompson 1971 (REML), Jennrich & Sampson 1976 (Fisher scoring of variance components).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls

from camcal.arrays import Array

# In pixels. Real images show 2 (interpolated colours), 1 (undersampled) and 1.25 (enlarged afterwards); a period of 2
# describes all of them to a few percent of the likelihood. Blocks of 8, as of JPEG, were not seen.
PERIODS = (2,)

_ITERATIONS, _HALVINGS = 50, 20
_TOLERANCE = 1e-12  # descent per residual, about the square of a relative change of its variance
_NOTHING = 1e-6  # of the largest; less counts as this in a geometric mean
_SMALLEST = 1e-12  # of the mean squared residual: keeps the likelihood finite where nothing is claimed


@dataclass(frozen=True)
class CornerNoise:
    """Standard deviations in each coordinate beyond the claimed covariance, px.

    floor_px: of every corner. period_px: of the errors of each of PERIODS, where edges are aligned with the pixel grid.
    """

    floor_px: float
    period_px: Mapping[int, float] = field(default_factory=lambda: dict.fromkeys(PERIODS, 0.0))

    def towards(self, other: "CornerNoise", share: float) -> "CornerNoise":
        """Return the noise a share of the way to another, in variances."""
        periods = {
            period: float(np.sqrt((1 - share) * self.period_px[period] ** 2 + share * other.period_px[period] ** 2))
            for period in PERIODS
        }
        return CornerNoise(float(np.sqrt((1 - share) * self.floor_px**2 + share * other.floor_px**2)), periods)

    def typical(self, shares: Array) -> float:
        """Return what is typically added, px: the geometric mean over all coordinates; shares: (N, 2, n)."""
        added = self.floor_px**2 + shares @ np.square([self.period_px[period] for period in PERIODS])
        most = added.max(initial=0.0)
        return float(np.sqrt(np.exp(np.mean(np.log(np.maximum(added, _NOTHING * most)))))) if most > 0 else 0.0

    def covariances(self, claimed: Array, shares: Array) -> Array:
        """Return the covariances (N, 2, 2), px², of corners whose images claim `claimed` (N, 2, 2), px².

        shares: (N, 2, n) as of `period_shares`.
        """
        total = np.array(claimed, dtype=np.float64)
        added = self.floor_px**2 + shares @ np.square([self.period_px[period] for period in PERIODS])
        total[:, [0, 1], [0, 1]] += added
        return total


def period_shares(axes: Array) -> Array:
    """Return the share (N, 2, n), 0…1, that is left of the variance of errors of each of PERIODS, in u and in v.

    axes: (N, 2, 2), the columns are the sides of a corner's square along the board's x and y, px.
    u is measured along the edges closest to vertical: those that cover the fewest columns, L sin θ for a side of L
    pixels at θ to the vertical. v is measured along those that cover the fewest rows.
    """
    return _left(np.abs(axes).min(axis=2)[..., None] / np.array(PERIODS))


def _left(covered: Array) -> Array:
    """Return what averaging over a number of periods leaves of the variance of a sine.

    That is sinc², beyond half a period its envelope, which touches it there: how far a corner's edges really count,
    and with it where the zeros are, is not known.
    """
    return np.where(covered < 0.5, np.sinc(covered) ** 2, 1 / (np.pi * np.maximum(covered, 0.5)) ** 2)


def estimate_noise(
    residuals: Array,
    claimed: Array,
    shares: Array,
    weights: Array,
    freedom: float | Array,
    start: CornerNoise | None = None,
) -> CornerNoise:
    """Return the noise under which the residuals of a calibration are likeliest.

    residuals: (N, 2) px. claimed: (N, 2, 2) px², of which only the variances count. shares: (N, 2, n) as of
    `period_shares`. weights: (N,) 0…1, how much a corner counts; at 0 it may be NaN. freedom: degrees of freedom per
    coordinate, below 1 as residuals of a fit are too small; one for all or (N,). start: saves time, changes nothing.

    Each a_p² has an exponential prior with the mean squared residual as its mean. Where corners tell of a_p² it does
    not matter; where they do not, as on boards that no view shows aligned with the pixels, it keeps a_p² small.
    """
    data = _Data.of(residuals, claimed, shares, weights, freedom)
    if data.scale == 0:
        return CornerNoise(0.0)
    variances = data.scale * np.eye(1, 1 + len(PERIODS))[0]
    if start is not None:
        variances = np.square([start.floor_px, *(start.period_px[period] for period in PERIODS)])
    misfit = data.misfit(variances)
    for _ in range(_ITERATIONS):
        step, descent = data.step(variances)
        if descent <= _TOLERANCE * data.weights.sum():
            break
        for _ in range(_HALVINGS):  # whole steps go to and fro where a period is known from a few corners alone
            trial = data.misfit(variances + step)
            if trial <= misfit:
                break
            step /= 2
        variances, misfit = variances + step, trial
    floor, *periods = np.sqrt(variances).tolist()
    return CornerNoise(floor, dict(zip(PERIODS, periods, strict=True)))


@dataclass(frozen=True, eq=False)
class _Data:
    """Residuals as independent numbers (M,): u, then v of every corner that counts.

    squared: per degree of freedom, px². claimed: variances, px². design: (1 + n, M), how much of the variances f², a_p²
    each has. weights: degrees of freedom that each counts for. scale: px², the mean of `squared`.
    """

    squared: Array
    claimed: Array
    design: Array
    weights: Array
    scale: float

    @classmethod
    def of(cls, residuals: Array, claimed: Array, shares: Array, weights: Array, freedom: float | Array) -> "_Data":
        counts = weights > 0
        free = np.broadcast_to(freedom, weights.shape)[counts]
        squared = (residuals[counts] ** 2 / free[:, None]).T.ravel()
        variances = np.diagonal(claimed, axis1=1, axis2=2)[counts].T.ravel()
        design = np.ones((1 + len(PERIODS), len(squared)))
        design[1:] = shares[counts].transpose(2, 1, 0).reshape(len(PERIODS), len(squared))
        weight = np.tile(weights[counts] * free, 2)
        scale = float(weight @ squared / weight.sum()) if counts.any() else 0.0
        return cls(squared, variances, design, weight, scale)

    @property
    def slope(self) -> Array:
        """Return the derivatives (1 + n,) of twice the prior's negative logarithm."""
        return np.append(0.0, np.full(len(PERIODS), 2 / self.scale))

    def total(self, variances: Array) -> Array:
        """Return the variance (M,) of every residual, px²."""
        return np.asarray(np.maximum(self.claimed + variances @ self.design, _SMALLEST * self.scale))

    def misfit(self, variances: Array) -> float:
        """Return twice the negative logarithm of the posterior density of variances (1 + n,), px²."""
        total = self.total(variances)
        return float(self.weights @ (np.log(total) + self.squared / total) + self.slope @ variances)

    def step(self, variances: Array) -> tuple[Array, float]:
        """Return a step (1 + n,) of Fisher scoring to variances of which none is negative, and the misfit's descent
        along it, to first order.
        """
        weighted = self.design * (self.weights / self.total(variances) ** 2)
        information = weighted @ self.design.T
        wanted = weighted @ (self.squared - self.claimed) - self.slope
        # the minimum of ½ xᵀ A x - bᵀ x over x ≥ 0, as least squares in the root of A; a period that no corner shows
        # has no row in A
        size = np.sqrt(np.maximum(np.diag(information), 1e-30 * information[0, 0]))
        root = np.linalg.cholesky(information / np.outer(size, size) + 1e-12 * np.eye(len(size)))
        solution, _ = nnls(root.T, np.linalg.solve(root, wanted / size))
        step = solution / size - variances
        return step, float((wanted - information @ variances) @ step)
