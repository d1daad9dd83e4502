"""What a fit is worth: values with intervals, correlations, goodness, and what the data cannot tell."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.curves.curve import Curve, Data

FLAGGED_CORRELATION = 0.99
IGNORED = 0.5  # a row whose loss leaves it less than this weight counts as an outlier


@dataclass(frozen=True)
class Estimate:
    """A value, its standard error and its 95 % interval; None where the data do not say.

    held: why it has no error of its own ('fixed', 'bound', 'unobservable'), None for a free one.
    """

    value: float
    std: float | None
    interval: tuple[float, float] | None
    held: str | None = None


@dataclass(frozen=True)
class Goodness:
    """How well the curve fits.

    sum_of_squares: of residuals, divided by sigma where it is known; sigma: their standard deviation, estimated with
    `freedom` degrees of freedom, None without any. chi_square, p_value: where sigma is known. r_squared: of an
    explicit curve. rms: of the residuals as they are.
    """

    rows: int
    freedom: int
    sum_of_squares: float
    rms: float
    sigma: float | None
    chi_square: float | None
    p_value: float | None
    r_squared: float | None


@dataclass(frozen=True, eq=False)
class CurveFit:
    """A fitted curve.

    covariance: (L, L) of the parameters named by `free`, NaN where unobservable. combinations: changes of parameters
    that change nothing. residuals: (N, D) predicted minus measured. weights: (N,) of the loss. leverage: (N,).
    bounds: the least and greatest value (K,) of every parameter.
    """

    curve: Curve
    data: Data
    parameters: Mapping[str, Estimate]
    derived: Mapping[str, Estimate]
    free: tuple[str, ...]
    covariance: Array
    goodness: Goodness
    condition: float
    combinations: tuple[Mapping[str, float], ...]
    iterations: int
    runs: int
    converged: bool
    reason: str
    residuals: Array
    weights: Array
    leverage: Array
    bounds: tuple[Array, Array]

    @property
    def values(self) -> Array:
        """The parameters (K,)."""
        return np.array([estimate.value for estimate in self.parameters.values()])

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """The parameters that a bound keeps from going further."""
        return tuple(name for name, estimate in self.parameters.items() if estimate.held == "bound")

    @property
    def outliers(self) -> Array:
        """Which rows (N,) a robust loss leaves less than half of their weight."""
        return np.asarray(self.weights < IGNORED)

    def correlations(self) -> Array:
        """Return the correlations (L, L) of the free parameters."""
        std = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(std, std))

    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Return the pairs of parameters that are hardly told apart, with their correlation."""
        matrix = self.correlations()
        pairs = zip(*np.triu_indices(len(self.free), 1), strict=True)
        return [
            (self.free[i], self.free[j], float(matrix[i, j]))
            for i, j in pairs
            if abs(matrix[i, j]) > FLAGGED_CORRELATION
        ]
