"""What a search found, assessed: standard errors, intervals, goodness of fit."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from camcal.arrays import Array
from camcal.estimate.curves import robust
from camcal.estimate.curves.curve import Curve, Data
from camcal.estimate.curves.result import CurveFit, Estimate, Goodness
from camcal.estimate.curves.search import Observe, Search, SearchOptions, search
from camcal.solve.dense import DenseEquations, DenseFactors, assemble_dense

CONFIDENCE = 0.95


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


def quantile(data: Data, freedom: int) -> float:
    """Return how many standard errors a 95 % interval reaches: normal where sigma is known, else Student's t."""
    from scipy.special import ndtri, stdtrit

    tail = 0.5 + CONFIDENCE / 2
    return float(ndtri(tail) if data.sigma is not None else stdtrit(max(freedom, 1), tail))


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
            self._parameters(covariance),
            self._derived(moving, covariance),
            tuple(moving),
            covariance,
            self._goodness(),
            self.factors.condition,
            tuple(self.factors.null_space(moving)),
            found.iterations,
            self.search.runs,
            found.converged,
            found.reason,
            self.residuals,
            self.weights,
            self.factors.leverage().reshape(self.residuals.shape).sum(axis=1),
            (self.problem.low, self.problem.high),
        )

    def _moving(self) -> Array:
        """Return which free parameters (L,) no bound holds back."""
        low, high = self.problem.room(self.state)
        gradient = self.equations.gradient
        return ~((low >= 0) & (gradient > 0) | (high <= 0) & (gradient < 0))

    @property
    def freedom(self) -> int:
        count = len(self.residuals) * self.problem.curve.freedom
        return int(count - self.factors.rank)

    def _noise(self) -> float | None:
        """Return the variance of a residual divided by sigma: 1 where sigma is known, None where nothing says."""
        if self.problem.data.sigma is not None:
            return 1.0
        return float(self.squared.sum()) / self.freedom if self.freedom > 0 else None

    def _covariance(self) -> Array:
        loss = self.problem.loss
        if loss is None:
            factor = self._noise()
            factors = self.factors
        else:
            # the loss's weights are no information: the Jacobian counts without them
            factor = robust.covariance_factor(loss, self.squared, self.problem.curve.freedom, self.factors.rank)
            factors = self._unweighted().factors(columns=self.moving)
        covariance = factors.covariance()
        return np.asarray(covariance * (np.nan if factor is None else factor))

    def _unweighted(self) -> DenseEquations:
        return assemble_dense(replace(self.problem, loss=None).blocks(self.state), self.problem.shared)

    def _estimate(self, value: float, variance: float) -> Estimate:
        if not np.isfinite(variance):
            return Estimate(value, None, None, "unobservable" if self.freedom > 0 and np.isfinite(value) else None)
        std = float(np.sqrt(variance))
        reach = quantile(self.problem.data, self.freedom) * std
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
        if noise is None and self.freedom > 0:
            noise = float(np.sqrt(total / self.freedom))
        chi_square = total if known else None
        p_value = float(chdtrc(self.freedom, total)) if known and self.freedom > 0 else None
        rms = float(np.sqrt(np.mean(np.sum(self.residuals**2, axis=1))))
        return Goodness(len(self.residuals), self.freedom, total, rms, noise, chi_square, p_value, self._r_squared())

    def _r_squared(self) -> float | None:
        """Return the share of the target's variance about its weighted mean that the curve explains."""
        target, sigma = self.problem.data.target, self.problem.data.sigma
        if target is None:
            return None
        weights = np.ones_like(target) if sigma is None else sigma**-2.0
        spread = float(np.sum(weights * (target - np.average(target, weights=weights)) ** 2))
        return 1 - float(self.squared.sum()) / spread if spread > 0 else None
