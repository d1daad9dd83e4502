"""A curve fitted and assessed: standard errors, likelihood intervals, goodness of fit, and the better of two curves.

Likelihood intervals end where the best fit with one parameter held is as unlikely as the confidence allows. They follow
curved likelihoods, for which value ± t·std is symmetric and wrong.
Sources: Bates & Watts, Nonlinear Regression Analysis and Its Applications, 1988, section 6.1; Burnham & Anderson, Model
Selection and Multimodel Inference, 2nd ed. 2002, sections 2.2 and 2.4 (AIC, AICc); Schwarz 1978 (BIC).
"""

from collections.abc import Callable, Mapping

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.estimate.curves.curve import Curve, CurveFit, Data, Estimate, Goodness
from camcal.estimate.curves.search import CurveProblem, Observe, Search, SearchOptions, covariance_factor, search
from camcal.solve.dense import (
    DenseEquations,
    DenseFactors,
    DenseMethod,
    assemble_dense,
    linearise_dense,
    minimise_dense,
)
from camcal.solve.descent import Stopping

CONFIDENCE = 0.95
_EVEN = 2.0  # a difference of AICc that says nothing (Burnham & Anderson 2002, section 2.6)
_STOPPING = Stopping(1e-10, 200, damping=1e-3, least=1 / 3, rise=2.0)
_DOUBLINGS = 12
_EXACT = 1e-4  # of the reach: intervals are not read more finely
End = float | None


def fit_curve(
    curve: Curve,
    data: Data,
    start: Mapping[str, float],
    options: SearchOptions | None = None,
    observe: Observe = lambda _run, _turn: None,
) -> CurveFit:
    """Return a curve fitted to data from a start that names every parameter; see `search` for what it raises.

    The result says whether the search converged; standard errors are those of the linearised problem at its end,
    without damping, with the scatter of the residuals for the noise where sigma is unknown.
    """
    found = search(curve, data, start, options or SearchOptions(), observe)
    return _Assessment(found).result()


def quantile(data: Data, dof: int) -> float:
    """Return how many standard errors a 95 % interval reaches: normal where sigma is known, else Student's t."""
    from scipy.special import ndtri, stdtrit

    tail = 0.5 + CONFIDENCE / 2
    return float(ndtri(tail) if data.sigma is not None else stdtrit(max(dof, 1), tail))


class _Assessment:
    """The figures of one search, each computed once."""

    def __init__(self, found: Search) -> None:
        self.search = found
        self.problem = found.problem
        self.state = found.found.state
        self.equations = found.found.equations
        self.moving = self._moving()
        self.factors: DenseFactors = self.equations.factors(columns=self.moving)
        block = self.problem.blocks(self.state)[0]
        self.residuals = block.residuals
        root = np.ones(len(self.residuals)) if block.weights is None else np.sqrt(block.weights)
        self.whitened = self.residuals * root[:, None]
        self.squared = np.einsum("nd,nd->n", self.whitened, self.whitened)
        self.weights = np.ones(len(root)) if block.loss is None else block.loss.weight(self.squared)

    def result(self) -> CurveFit:
        names = [self.problem.curve.parameters[index] for index in self.problem.free]
        moving = [name for name, moves in zip(names, self.moving, strict=True) if moves]
        covariance = self._covariance()
        found = self.search.found
        return CurveFit(
            self.problem.curve,
            self.problem.data,
            parameters=self._parameters(covariance),
            derived=self._derived(moving, covariance),
            free=tuple(moving),
            covariance=covariance,
            goodness=self._goodness(),
            condition=self.factors.condition,
            combinations=tuple(self.factors.null_space(moving)),
            iterations=found.iterations,
            runs=self.search.runs,
            converged=found.converged,
            reason=found.reason,
            residuals=self.residuals,
            weights=self.weights,
            leverage=self.factors.leverage().reshape(self.residuals.shape).sum(axis=1),
            bounds=(self.problem.low, self.problem.high),
        )

    def _moving(self) -> Array:
        """Return which free parameters (L,) no bound holds back."""
        low, high = self.problem.room(self.state)
        gradient = self.equations.gradient
        return ~((low >= 0) & (gradient > 0) | (high <= 0) & (gradient < 0))

    @property
    def degrees_of_freedom(self) -> int:
        count = len(self.residuals) * self.problem.curve.components
        return int(count - self.factors.rank)

    def _noise(self) -> float | None:
        """Return the variance of a residual divided by sigma: 1 where sigma is known, None where unknown."""
        if self.problem.data.sigma is not None:
            return 1.0
        return float(self.squared.sum()) / self.degrees_of_freedom if self.degrees_of_freedom > 0 else None

    def _covariance(self) -> Array:
        loss = self.problem.loss
        if loss is None:
            factor = self._noise()
            factors = self.factors
        else:
            # the loss's weights are no information: the Jacobian counts without them
            factor = covariance_factor(loss, self.squared, self.problem.curve.components, self.factors.rank)
            factors = self._unweighted().factors(columns=self.moving)
        covariance = factors.covariance()
        return np.asarray(covariance * (np.nan if factor is None else factor))

    def _unweighted(self) -> DenseEquations:
        return assemble_dense(replace(self.problem, loss=None).blocks(self.state), self.problem.shared)

    def _estimate(self, value: float, variance: float) -> Estimate:
        if not np.isfinite(variance):
            return Estimate(
                value, None, None, "unobservable" if self.degrees_of_freedom > 0 and np.isfinite(value) else None
            )
        std = float(np.sqrt(variance))
        reach = quantile(self.problem.data, self.degrees_of_freedom) * std
        return Estimate(value, std, (value - reach, value + reach))

    def _parameters(self, covariance: Array) -> dict[str, Estimate]:
        values = self.problem.full(self.state)
        names = self.problem.curve.parameters
        held = {name: Estimate(float(value), None, None, "fixed") for name, value in zip(names, values, strict=True)}
        variances = iter(np.diag(covariance))
        for index, moves in zip(self.problem.free, self.moving, strict=True):
            value = float(values[index])
            held[names[index]] = (
                self._estimate(value, float(next(variances))) if moves else Estimate(value, None, None, "bound")
            )
        return held

    def _derived(self, moving: list[str], covariance: Array) -> dict[str, Estimate]:
        """Return further figures with the errors that the parameters' covariance gives them."""
        known = dict(zip(self.problem.curve.parameters, self.problem.full(self.state), strict=True))
        result = {}
        for name, formula in self.problem.curve.derived.items():
            dual = formula.with_derivatives(known, moving)
            slopes = np.zeros(len(moving)) if dual.slopes is None else dual.slopes.reshape(len(moving))
            used = slopes != 0
            variance = float(slopes[used] @ covariance[np.ix_(used, used)] @ slopes[used])
            result[name] = self._estimate(float(dual.value), variance)
        return result

    def _goodness(self) -> Goodness:
        from scipy.special import chdtrc

        known = self.problem.data.sigma is not None
        total = float(self.squared.sum())
        noise = self.search.scale if self.search.scale is not None and not known else None
        if noise is None and self.degrees_of_freedom > 0:
            noise = float(np.sqrt(total / self.degrees_of_freedom))
        chi_square = total if known else None
        p_value = float(chdtrc(self.degrees_of_freedom, total)) if known and self.degrees_of_freedom > 0 else None
        rms = float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))
        return Goodness(
            len(self.residuals),
            self.degrees_of_freedom,
            sum_of_squares=total,
            rms=rms,
            sigma=noise,
            chi_square=chi_square,
            p_value=p_value,
            r_squared=self._r_squared(),
        )

    def _r_squared(self) -> float | None:
        """Return the share of the target's variance about its weighted mean that the curve explains."""
        target, sigma = self.problem.data.target, self.problem.data.sigma
        if target is None:
            return None
        weights = np.ones_like(target) if sigma is None else sigma**-2.0
        spread = float(np.sum(weights * (target - np.average(target, weights=weights)) ** 2))
        return 1 - float(self.squared.sum()) / spread if spread > 0 else None


@dataclass(frozen=True)
class Criteria:
    """Information criteria of a fit, lower is better; aicc is None where there are too few data for it."""

    aic: float
    aicc: float | None
    bic: float


@dataclass(frozen=True)
class Comparison:
    """The first fit beside the second.

    preferred: which of the two has the lower AICc by more than 2 (AIC where there is none), or 'neither'.
    f, p_value: the F test of the larger against the smaller one, which must be a special case of it; None where the
    two have as many parameters or the larger one fits worse.
    """

    first: Criteria
    second: Criteria
    preferred: str
    f: float | None
    p_value: float | None


def criteria(fit: CurveFit) -> Criteria:
    """Return the information criteria of a least-squares fit with normal errors."""
    good = fit.goodness
    count = good.rows * fit.curve.components
    parameters = count - good.degrees_of_freedom
    if good.chi_square is not None:
        surprise = good.chi_square
    else:
        surprise = count * float(np.log(max(good.sum_of_squares, np.finfo(float).tiny) / count))
        parameters += 1  # the noise is estimated too
    aic = surprise + 2 * parameters
    spare = count - parameters - 1
    aicc = aic + 2 * parameters * (parameters + 1) / spare if spare > 0 else None
    return Criteria(aic, aicc, surprise + parameters * float(np.log(count)))


def compare(first: CurveFit, second: CurveFit) -> Comparison:
    """Return how two least-squares fits to the same data compare."""
    of_first, of_second = criteria(first), criteria(second)
    if of_first.aicc is not None and of_second.aicc is not None:
        lead = of_second.aicc - of_first.aicc
    else:
        lead = of_second.aic - of_first.aic
    preferred = "neither" if abs(lead) <= _EVEN else "first" if lead > 0 else "second"
    return Comparison(of_first, of_second, preferred, *_f_test(first, second))


def _f_test(first: CurveFit, second: CurveFit) -> tuple[float | None, float | None]:
    from scipy.special import fdtrc

    smaller, larger = sorted((first, second), key=lambda fit: -fit.goodness.degrees_of_freedom)
    extra = smaller.goodness.degrees_of_freedom - larger.goodness.degrees_of_freedom
    gain = smaller.goodness.sum_of_squares - larger.goodness.sum_of_squares
    if extra == 0 or larger.goodness.degrees_of_freedom <= 0 or gain < 0 or larger.goodness.sum_of_squares == 0:
        return None, None
    value = gain / extra / (larger.goodness.sum_of_squares / larger.goodness.degrees_of_freedom)
    return value, float(fdtrc(extra, larger.goodness.degrees_of_freedom, value))


@dataclass
class _Profile:
    """The cost with one parameter held, as a function of its value; every fit starts where the last one ended."""

    fit: CurveFit
    index: int
    best: float
    noise: float
    state: Array

    def height(self, value: float) -> float:
        """Return the root of twice the rise of the cost above its minimum, in standard deviations of the residuals."""
        problem = self._held(value)
        if not len(problem.free):
            equations = linearise_dense(problem, np.zeros(0))
            cost = np.inf if equations is None else equations.cost
        else:
            cost = self._minimum(problem)
        return float(np.sqrt(max(2 * (cost - self.best), 0.0)) / self.noise)

    def _minimum(self, problem: CurveProblem) -> float:
        equations = linearise_dense(problem, self.state)
        if equations is None or not np.isfinite(equations.cost):
            return np.inf
        found = minimise_dense(problem, self.state, DenseMethod(room=problem.room), _STOPPING)
        self.state = found.state
        return found.equations.cost

    def _held(self, value: float) -> CurveProblem:
        fit, values = self.fit, self.fit.values.copy()
        values[self.index] = value
        names = fit.curve.parameters
        free = np.array([i for i, name in enumerate(names) if name in fit.free and i != self.index], dtype=int)
        return CurveProblem(fit.curve, fit.data, values, free, *fit.bounds)


def likelihood_intervals(fit: CurveFit) -> dict[str, tuple[End, End]]:
    """Return the 95 % interval of every free parameter of a least-squares fit by name; None for an end that is open.

    An end is open if no value of the parameter is unlikely enough, up to its bound or thousands of standard errors.
    """
    noise = fit.goodness.sigma
    if fit.goodness.degrees_of_freedom <= 0 or not noise:
        return dict.fromkeys(fit.free, (None, None))
    if fit.data.sigma is not None:
        noise = 1.0
    return {name: (_end(fit, name, noise, -1), _end(fit, name, noise, 1)) for name in fit.free}


def _end(fit: CurveFit, name: str, noise: float, side: int) -> End:
    std = fit.parameters[name].std
    if not std:
        return None
    index = fit.curve.parameters.index(name)
    others = np.array([fit.values[fit.curve.parameters.index(other)] for other in fit.free if other != name])
    profile = _Profile(fit, index, 0.5 * fit.goodness.sum_of_squares, noise, others)
    wanted = quantile(fit.data, fit.goodness.degrees_of_freedom)
    limit = float(fit.bounds[side > 0][index])
    return _crossing(profile.height, fit.values[index], side * wanted * std, limit, wanted)


def _crossing(height: Callable[[float], float], middle: float, reach: float, limit: float, wanted: float) -> End:
    """Return where a rising height crosses `wanted` on one side of the middle, None if it does not before a limit."""
    from scipy.optimize import brentq

    low, high = middle, middle + reach
    for _ in range(_DOUBLINGS):
        high = min(high, limit) if reach > 0 else max(high, limit)
        if height(high) >= wanted:
            value = brentq(lambda v: height(v) - wanted, low, high, xtol=_EXACT * abs(reach), rtol=1e-12)
            return float(value)
        if high == limit:
            return None
        low, high = high, middle + 2 * (high - middle)
    return None
