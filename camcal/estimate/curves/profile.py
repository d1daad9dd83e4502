"""Likelihood intervals: where the best fit with one parameter held is as unlikely as the confidence allows.

They follow curved likelihoods, for which value ± t·std is symmetric and wrong.
Source: Bates & Watts, Nonlinear Regression Analysis and Its Applications, 1988, section 6.1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.curves.fit import quantile
from camcal.estimate.curves.problem import CurveProblem
from camcal.estimate.curves.result import CurveFit
from camcal.solve.dense import DenseMethod, linearise_dense, minimise_dense
from camcal.solve.descent import Stopping

_STOPPING = Stopping(1e-10, 200, damping=1e-3, least=1 / 3, rise=2.0)
_DOUBLINGS = 12
_EXACT = 1e-4  # of the reach: intervals are not read more finely

End = float | None


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
    if fit.goodness.freedom <= 0 or not noise:
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
    wanted = quantile(fit.data, fit.goodness.freedom)
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
