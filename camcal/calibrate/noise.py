"""Corner noise beyond the detection covariances: of all views, of one view, of a single corner.

Medians alone say which corners cannot be measurements of this board through this lens. Beyond that a corner's weight
falls smoothly where its residual is beyond four standard deviations, 1 / (1 + (d² / 16)³); a view's where its corners
are 16 times as noisy as those of a typical view. Both are taken again in every pass.

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

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field
from camcal.solve.dense import minimise_nonnegative

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

# of d² = x² + y² with standard normal x and y, whose half has an exponential distribution
_NODES, _SHARES = np.polynomial.laguerre.laggauss(60)

# In pixels. Real images show 2 (interpolated colours), 1 (undersampled) and 1.25 (enlarged afterwards); a period of 2
# describes all of them to a few percent of the likelihood. Blocks of 8, as of JPEG, were not seen.
PERIODS = (2,)
_ITERATIONS, _HALVINGS = 50, 20
_TOLERANCE = 1e-12  # descent per residual, about the square of a relative change of its variance
_NOTHING = 1e-6  # of the largest; less counts as this in a geometric mean
_SMALLEST = 1e-12  # of the mean squared residual: keeps the likelihood finite where nothing is claimed

CUT = 4.5  # in σ of medians: 4 of 100 000 clean corners are lost
_LEAST_ROBUST = 1e-3  # px; as FINEST, of a σ by the median
RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))


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
    # what counts for little has no information on its noise: all its corners do, by their median
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


@dataclass(frozen=True)
class CornerNoise:
    """Standard deviations in each coordinate beyond the claimed covariance, px.

    constant_px: of every corner. period_px: of the errors of each of PERIODS, where edges are aligned with the
    pixel grid.
    """

    constant_px: float
    period_px: Mapping[int, float] = field(default_factory=lambda: dict.fromkeys(PERIODS, 0.0))

    def towards(self, other: "CornerNoise", share: float) -> "CornerNoise":
        """Return the noise a share of the way to another, in variances, none below a quarter of the other's."""

        def between(own: float, their: float) -> float:
            return float(np.sqrt(max((1 - share) * own**2 + share * their**2, their**2 / 4)))

        periods = {period: between(self.period_px[period], other.period_px[period]) for period in PERIODS}
        return CornerNoise(between(self.constant_px, other.constant_px), periods)

    def typical(self, shares: Array) -> float:
        """Return what is typically added, px: the geometric mean over all coordinates; shares: (N, 2, n)."""
        added = self.constant_px**2 + shares @ np.square([self.period_px[period] for period in PERIODS])
        most = added.max(initial=0.0)
        return float(np.sqrt(np.exp(np.mean(np.log(np.maximum(added, _NOTHING * most)))))) if most > 0 else 0.0

    def covariances(self, claimed: Array, shares: Array) -> Array:
        """Return the covariances (N, 2, 2), px², of corners whose images claim `claimed` (N, 2, 2), px².

        shares: (N, 2, n) as of `period_shares`.
        """
        total = np.array(claimed, dtype=np.float64)
        added = self.constant_px**2 + shares @ np.square([self.period_px[period] for period in PERIODS])
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
    dof: float | Array,
    start: CornerNoise | None = None,
) -> CornerNoise:
    """Return the noise under which the residuals of a calibration are likeliest.

    residuals: (N, 2) px. claimed: (N, 2, 2) px², of which only the variances count. shares: (N, 2, n) as of
    `period_shares`. weights: (N,) 0…1, how much a corner counts; at 0 it may be NaN. dof: degrees of freedom per
    coordinate, below 1 as residuals of a fit are too small; one for all or (N,). start: saves time, changes nothing.

    Each a_p² has an exponential prior with the mean squared residual as its mean. Where corners tell of a_p² it does
    not matter; where they do not, as on boards that no view shows aligned with the pixels, it keeps a_p² small.
    """
    data = _Data.of(residuals, claimed, shares, weights, dof)
    if data.scale == 0:
        return CornerNoise(0.0)
    variances = data.scale * np.eye(1, 1 + len(PERIODS))[0]
    if start is not None:
        variances = np.square([start.constant_px, *(start.period_px[period] for period in PERIODS)])
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
    def of(cls, residuals: Array, claimed: Array, shares: Array, weights: Array, dof: float | Array) -> "_Data":
        counts = weights > 0
        free = np.broadcast_to(dof, weights.shape)[counts]
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
        # a period that no corner shows has no row in the information
        size = np.sqrt(np.maximum(np.diag(information), 1e-30 * information[0, 0]))
        scaled = information / np.outer(size, size) + 1e-12 * np.eye(len(size))
        step = minimise_nonnegative(scaled, wanted / size) / size - variances
        return step, float((wanted - information @ variances) @ step)


def robust_sigma(distances: Array, present: Array, dof: float = 1.0) -> float:
    """Return σ per coordinate from the median of distances (V, P) of present points.

    dof: degrees of freedom per coordinate, < 1 as fitted residuals are too small. Distances of two Gaussian
    coordinates have the median σ √(2 ln 2).
    """
    values = distances[present]
    median = float(np.median(np.where(np.isnan(values), np.inf, values))) if len(values) else 0.0
    return max(float(median / RAYLEIGH_MEDIAN / np.sqrt(dof)), _LEAST_ROBUST)


def truncation(cut: float = CUT) -> float:
    """Return the share of the variance that is left of two Gaussian coordinates whose distance is cut at `cut` σ."""
    tail = np.exp(-(cut**2) / 2)
    return float(1 - cut**2 / 2 * tail / (1 - tail))


def row_medians(values: Array, present: Array) -> Array:
    """Return the medians (V,) of the values (V, P) of every row that are present, 0 where none is."""
    rows = zip(values, present, strict=True)
    return np.array([np.median(row[mask]) if mask.any() else 0.0 for row, mask in rows])
