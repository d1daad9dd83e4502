"""What rounding to whole counts, and ending at 0, did to the noise of dark frames."""

from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from camcal.arrays import Array
from camcal.errors import InsufficientData

ROUNDING = 1 / 12  # counts²: variance of an error that is uniform over one count
LIMIT = 0.24  # counts²: below this EMVA 1288 takes the noise for that of rounding
HIDDEN = sqrt(LIMIT - ROUNDING)  # counts: the noise that is then its upper limit, 0.40 in the standard

_COARSE = 3.0  # counts: noise above that is rounded evenly, as long as it stays away from 0
_REACH = 6.0  # standard deviations
_SMALLEST = 0.02  # counts: noise that is not looked for below, and spread that is too small to matter
_SILENT = 1e-4  # counts²: a variance that only rare outliers bring about
_VAGUE = 0.1  # of the noise: an uncertainty that only rounding brings about
_SINGULAR = 1e-6  # of the determinant: the counts do not tell the noise any more
_NODES = np.linspace(-4, 4, 49)  # standard deviations, fine enough for a spread of six times the noise
_WEIGHTS = np.exp(-(_NODES**2) / 2) / np.exp(-(_NODES**2) / 2).sum()


@dataclass(frozen=True)
class Noise:
    """A dark signal before it was counted, in counts: mean, standard deviation in time, and of the pixels' own means.

    limited: the noise is too small against a count to be measured well.
    """

    mean: float
    std: float
    std_uncertainty: float
    spread: float
    spread_uncertainty: float
    limited: bool


@dataclass(frozen=True)
class Counted:
    """Counts as they are measured: mean, variance in time, variance of the pixels' means, and their uncertainties."""

    mean: float
    temporal: float
    temporal_std: float
    spatial: float
    spatial_std: float


def before_counting(measured: Counted) -> Noise:
    """Return the Gaussian signals whose counts, rounded and cut off at 0, have these variances.

    Below the limit of EMVA 1288 rounding is undone as well, and the uncertainty grows as that fails; where all counts
    are the same the noise is its upper limit, 0.4 counts. Raises InsufficientData if all counts are 0.
    Source: EMVA 1288 Release 4.0 Linear (photon transfer method: 0.24 counts², 0.40 counts).
    """
    spread, spread_uncertainty = root(measured.spatial, measured.spatial_std)
    if measured.temporal < _SILENT:
        if measured.mean < _SILENT:
            raise InsufficientData("all dark counts are 0: the camera cuts its noise off; raise its black level")
        return Noise(measured.mean, HIDDEN, HIDDEN, spread, spread_uncertainty, limited=True)
    std, std_uncertainty = root(max(measured.temporal - ROUNDING, ROUNDING), measured.temporal_std)
    if std > _COARSE and measured.mean > _REACH * hypot(std, spread):
        return Noise(measured.mean, std, std_uncertainty, spread, spread_uncertainty, limited=False)
    return _undone(measured, (measured.mean, std, max(spread, _SMALLEST)))


def root(variance: float, std: float) -> tuple[float, float]:
    """Return the square root of a variance and its uncertainty; a negative one is no deviation, but for chance.

    Near zero the uncertainty is the deviation that the variance might be. `squared` undoes it.
    """
    value = sqrt(max(variance, 0.0))
    return value, std / 2 / value if value > sqrt(std) / 2 else sqrt(std)


def squared(value: float, std: float) -> tuple[float, float]:
    """Return the variance that has this root, and its uncertainty."""
    return value**2, max(2 * value * std, std**2)


def _undone(measured: Counted, guess: tuple[float, float, float]) -> Noise:
    """Return the mean, noise and spread whose counts are as measured, by least squares from a guess."""
    target = np.array([measured.mean, measured.temporal, measured.spatial])

    def residuals(unknown: Array) -> Array:
        return np.asarray(counted(*unknown) - target)

    bounds = ([-np.inf, _SMALLEST, 0.0], [np.inf, np.inf, np.inf])
    fit = least_squares(
        residuals, guess, bounds=bounds, x_scale=(1.0, guess[1], guess[1]), xtol=1e-12, ftol=1e-12, gtol=1e-15
    )
    mean, std, spread = fit.x.tolist()
    jacobian: Array = np.asarray(fit.jac)
    if spread < _SMALLEST:  # then it has no slope, and no part in the other two
        inverse = np.zeros((3, 3))
        inverse[:2, :2] = _inverse(jacobian[:2, :2])
        spread_uncertainty = sqrt(measured.spatial_std)
    else:
        inverse = _inverse(jacobian)
        spread_uncertainty = hypot(inverse[2, 1] * measured.temporal_std, inverse[2, 2] * measured.spatial_std)
    uncertainty = hypot(inverse[1, 1] * measured.temporal_std, inverse[1, 2] * measured.spatial_std)
    uncertainty = min(float(uncertainty), HIDDEN)  # where rounding hides the noise, it is below that at least
    limited = std < HIDDEN or uncertainty > _VAGUE * std or measured.temporal < LIMIT
    return Noise(mean, std, uncertainty, spread, spread_uncertainty, limited)


def _inverse(jacobian: Array) -> Array:
    if abs(np.linalg.det(jacobian)) < _SINGULAR:
        return np.full_like(jacobian, np.inf)
    return np.asarray(np.linalg.inv(jacobian))


def counted(mean: float, std: float, spread: float) -> Array:
    """Return mean, temporal and spatial variance (3,) of the rounded, non-negative counts of Gaussian signals.

    std: of a signal in time; spread: standard deviation of the signals' means. Sums over all counts, not a series.
    """
    means = mean + spread * _NODES
    first_count = max(0.0, np.floor(means[0] - _REACH * std))
    counts = np.arange(first_count, max(first_count, np.ceil(means[-1] + _REACH * std)) + 2)
    below = ndtr((counts[:-1] + 0.5 - means[:, None]) / std)
    shares = np.diff(below, axis=1, prepend=0.0, append=1.0)
    centres = shares @ counts
    temporal = _WEIGHTS @ (shares * (counts - centres[:, None]) ** 2).sum(axis=1)
    middle = _WEIGHTS @ centres
    return np.array([middle, temporal, _WEIGHTS @ (centres - middle) ** 2])
