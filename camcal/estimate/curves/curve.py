"""A curve: a formula for a measured value or for the distance of a point from a shape; the quality of a fit."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray
from camcal.dataclass import dataclass, field
from camcal.estimate.curves.expressions import Expression, parse
from camcal.records import Brief

Columns = Mapping[str, Array]
FLAGGED_CORRELATION = 0.99
IGNORED = 0.5  # a row whose loss leaves it less than this weight counts as an outlier


@dataclass(frozen=True)
class Curve(Brief):
    """Formulas over columns and parameters.

    explicit: the one formula predicts a measured column. Otherwise the formulas are components of the distance between
    a point and a shape. components: how many of them are independent. derived: other figures, by formulas over
    the parameters.
    """

    name: str
    formulas: tuple[Expression, ...]
    parameters: tuple[str, ...]
    explicit: bool = True
    components: int = 1
    derived: Mapping[str, Expression] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        name: str,
        formulas: Sequence[str],
        parameters: Sequence[str],
        derived: Mapping[str, str] | None = None,
        *,
        explicit: bool = True,
        components: int = 1,
    ) -> "Curve":
        """Return the curve of formulas as text; raises InvalidInput if one is none."""
        figures = {label: parse(text) for label, text in (derived or {}).items()}
        return cls(name, tuple(map(parse, formulas)), tuple(parameters), explicit, components, figures)

    @property
    def text(self) -> str:
        """The formulas as text."""
        return "; ".join(formula.text for formula in self.formulas)


@dataclass(frozen=True, eq=False)
class Data(Brief):
    """What a curve is fitted to: columns (N,) by the names its formulas use.

    target: (N,) what an explicit curve predicts, None for a shape. sigma: (N,) standard deviations, None if unknown.
    """

    columns: Mapping[str, FloatArray]
    target: FloatArray | None = None
    sigma: FloatArray | None = None

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.target is None else len(self.target)


def predictions(curve: Curve, columns: Columns, values: Array, rows: int) -> Array:
    """Return the formulas, (N, D), at parameter values (K,); NaN or infinite where they are not defined."""
    known = {**columns, **dict(zip(curve.parameters, values, strict=True))}
    return np.stack([_filled(formula.value(known), (rows,)) for formula in curve.formulas], axis=1)


def predictions_with_jacobian(
    curve: Curve, columns: Columns, values: Array, rows: int, by: Sequence[str]
) -> tuple[Array, Array]:
    """Return the values of the formulas (N, D), and their derivatives (N, D, L) by the parameters `by`."""
    known = {**columns, **dict(zip(curve.parameters, values, strict=True))}
    found = [formula.with_derivatives(known, by) for formula in curve.formulas]
    shape = len(by), rows
    slopes = [np.zeros(shape) if dual.slopes is None else _filled(dual.slopes, shape) for dual in found]
    predicted = [_filled(dual.value, (rows,)) for dual in found]
    return np.stack(predicted, axis=1), np.stack([slope.T for slope in slopes], axis=1)


def _filled(values: Array, shape: tuple[int, ...]) -> Array:
    return values if values.shape == shape else np.broadcast_to(values, shape)


@dataclass(frozen=True)
class Estimate:
    """A value, its standard error and its 95 % interval; None where the data do not determine it.

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
    `degrees_of_freedom`, None without any. chi_square, p_value: where sigma is known. r_squared: of an
    explicit curve. rms: of the residuals as they are.
    """

    rows: int
    degrees_of_freedom: int
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
    covariance: FloatArray
    goodness: Goodness
    condition: float
    combinations: tuple[Mapping[str, float], ...]
    iterations: int
    runs: int
    converged: bool
    reason: str
    residuals: FloatArray
    weights: FloatArray
    leverage: FloatArray
    bounds: tuple[FloatArray, FloatArray]

    @property
    def values(self) -> FloatArray:
        """The parameters (K,)."""
        return np.array([estimate.value for estimate in self.parameters.values()])

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """The parameters that a bound keeps from going further."""
        return tuple(name for name, estimate in self.parameters.items() if estimate.held == "bound")

    @property
    def outliers(self) -> BoolArray:
        """Which rows (N,) a robust loss leaves less than half of their weight."""
        return np.asarray(self.weights < IGNORED)

    def correlations(self) -> FloatArray:
        """Return the correlations (L, L) of the free parameters."""
        std = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(std, std))

    def strong_correlations(self) -> list[tuple[str, str, float]]:
        """Return the pairs of parameters that are hardly distinguished, with their correlation."""
        matrix = self.correlations()
        pairs = zip(*np.triu_indices(len(self.free), 1), strict=True)
        return [
            (self.free[i], self.free[j], float(matrix[i, j]))
            for i, j in pairs
            if abs(matrix[i, j]) > FLAGGED_CORRELATION
        ]
