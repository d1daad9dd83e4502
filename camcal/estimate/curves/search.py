"""The search for the best fit of a curve: its residuals as a problem, restarts, and losses for data with outliers."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.curves.curve import Curve, Data, predictions, predictions_with_jacobian
from camcal.records import Brief
from camcal.solve.dense import DenseEquations, DenseMethod, linearise_dense, minimise_dense
from camcal.solve.descent import Descent, Iteration, Stopping
from camcal.solve.losses import Cauchy, Huber, Loss, SoftL1, Tukey
from camcal.solve.steps import Block, Jacobian, Step

# Loss of each name, at 95 % of the efficiency of least squares for normal errors (computed from its ψ).
LOSSES: Mapping[str, tuple[Callable[[float], Loss], float]] = {
    "huber": (Huber, 1.345),
    "soft_l1": (SoftL1, 1.287),
    "cauchy": (Cauchy, 2.385),
    "tukey": (Tukey, 4.685),
}
_MEDIAN = {1: 0.6744897501960817, 2: 1.1774100225154747}  # of the length of a normal vector of so many components
_SMALL = 1e-4
METHODS = ("levenberg-marquardt", "gauss-newton")
Found = Descent[Array, DenseEquations]
Observe = Callable[[int, Iteration], None]

_ITERATIONS = 2000
LARGEST = 1e100  # of residuals and slopes: sums of their squares are numbers
_ROUNDS, _STEADY = 30, 1e-3  # of the scale of a robust fit: how often it is estimated again, and when it has settled


@dataclass(frozen=True, eq=False)
class CurveProblem:
    """Predicted minus measured; `free` (L,) indices of the parameters that move, the others stay at `values` (K,).

    low, high: (K,) bounds. loss: of residuals divided by sigma.
    """

    curve: Curve
    data: Data
    values: Array
    free: Array
    low: Array
    high: Array
    loss: Loss | None = None

    @property
    def shared(self) -> int:
        return len(self.free)

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def full(self, state: Array) -> Array:
        """Return all parameters (K,) at a state (L,)."""
        result = np.array(self.values)
        result[self.free] = state
        return result

    def blocks(self, state: Array) -> Sequence[Block]:
        """Return the one block of residuals; numbers in it are not finite where the curve is not defined."""
        names = [self.curve.parameters[index] for index in self.free]
        predicted, slopes = predictions_with_jacobian(
            self.curve, self.data.columns, self.full(state), len(self.data), names
        )
        target = 0.0 if self.data.target is None else self.data.target[:, None]
        weights = None if self.data.sigma is None else self.data.sigma**-2.0
        with np.errstate(invalid="ignore", over="ignore"):
            residuals = predicted - target
        return [Block(residuals, (Jacobian(slopes, np.arange(self.shared)),), weights=weights, loss=self.loss)]

    def residuals(self, state: Array) -> Array:
        """Return the residuals (N·D,) alone."""
        predicted = predictions(self.curve, self.data.columns, self.full(state), len(self.data))
        return np.asarray(predicted if self.data.target is None else predicted - self.data.target[:, None]).ravel()

    def retract(self, state: Array, step: Step) -> Array:
        """Return the parameters moved by a step; a bound that the step ends at is met exactly."""
        return np.asarray(np.clip(state + step.shared, self.low[self.free], self.high[self.free]))

    def room(self, state: Array) -> tuple[Array, Array]:
        """Return the least and the greatest step that the bounds allow."""
        return self.low[self.free] - state, self.high[self.free] - state

    def rounding(self) -> float:
        """Return the cost of residuals that are rounding errors of the data and nothing else."""
        if self.data.target is None:
            sizes = np.sqrt(np.sum([column**2 for column in self.data.columns.values()], axis=0))
        else:
            sizes = self.data.target
        weighted = sizes if self.data.sigma is None else sizes / self.data.sigma
        return 0.5 * float(np.sum((np.finfo(float).eps * weighted) ** 2))


def spread(residuals: Array, components: int, parameters: int) -> float:
    """Return the standard deviation of residuals (N, D) by the median of their lengths, which outliers hardly move.

    components: how many of the D are independent. parameters: how many the residuals were fitted by.
    """
    count = len(residuals) * components
    lengths = np.linalg.norm(residuals, axis=1)
    correction = np.sqrt(count / max(count - parameters, 1))
    return float(np.median(lengths) / _MEDIAN[components] * correction)


def covariance_factor(loss: Loss, squared: Array, components: int, parameters: int) -> float:
    """Return what (JᵀJ)⁻¹ of unweighted residuals is to be multiplied by to be the covariance of a robust fit.

    squared: (N,) squared lengths of the residuals. With ψ(r) = ρ'(r²) r it is E[ψ²] / E[ψ']², corrected for the
    number of parameters. Source: Huber, Robust Statistics, 1981, equations 6.5 and 7.6.
    """
    weights = loss.weight(squared)
    higher, lower = squared * (1 + _SMALL), squared * (1 - _SMALL)
    bend = (loss.weight(higher) - loss.weight(lower)) / (2 * _SMALL)  # s dρ'/ds
    slopes = weights + 2 * bend / components
    count = len(squared) * components
    power = float(np.sum(weights**2 * squared)) / max(count - parameters, 1)
    mean = float(np.mean(slopes))
    correction = 1 + parameters / count * float(np.var(slopes)) / mean**2
    return correction**2 * power / mean**2


@dataclass(frozen=True)
class SearchOptions(Brief):
    """How to fit: bounds and fixed parameters by name, the loss, further starts, the method."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    fixed: frozenset[str] = frozenset()
    loss: str = "none"
    restarts: int = 0
    method: str = METHODS[0]
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Search:
    """The best end of all searches: problem (with its loss), descent, how many ran, the scale of the residuals' loss.

    scale: standard deviation of a residual (divided by sigma) that the loss is tuned to, None for least squares.
    """

    problem: CurveProblem
    found: Found
    runs: int
    scale: float | None


def search(curve: Curve, data: Data, start: Mapping[str, float], options: SearchOptions, observe: Observe) -> Search:
    """Return the lowest minimum found from a start that names every parameter.

    Levenberg–Marquardt runs twice from each start, with the running and with the present scale of the parameters: the
    first is safe, the second follows narrow valleys to their end. `observe` is called with the run in every iteration.
    Raises InvalidInput for a start outside its bounds or where the curve is undefined, InsufficientData for few data.
    """
    problem = _problem(curve, data, start, options)
    count = len(data) * curve.components
    if count < problem.shared:
        raise InsufficientData(f"too few data ({count} for {problem.shared} parameters): add data or --fix some")
    if data.sigma is not None and not np.all(data.sigma > 0):
        raise InvalidInput(f"sigma must be positive, found {float(np.min(data.sigma)):g}")
    _require_defined(problem)
    searches = _Searches(options, observe)
    if options.loss == "none":
        return Search(problem, searches.best(problem), searches.runs, None)
    # Huber's loss comes first, which has one minimum for straight models: one that ignores outliers needs to start
    # where they are known as such. Where sigma is unknown, the scale is that of the fit's own residuals.
    first = _search_with(problem, "huber", searches)
    return first if options.loss == "huber" else _search_with(first.problem, options.loss, searches)


def _problem(curve: Curve, data: Data, start: Mapping[str, float], options: SearchOptions) -> CurveProblem:
    values = np.array([start[name] for name in curve.parameters], dtype=float)
    limits = [options.bounds.get(name, (-np.inf, np.inf)) for name in curve.parameters]
    low, high = np.array(limits, dtype=float).reshape(-1, 2).T
    for name, value, least, greatest in zip(curve.parameters, values, low, high, strict=True):
        if not least <= value <= greatest:
            raise InvalidInput(f"the start {name}={value:g} is outside its bounds {least:g} … {greatest:g}")
    free = np.flatnonzero([name not in options.fixed for name in curve.parameters])
    if not len(free):
        raise InvalidInput("all parameters are fixed")
    return CurveProblem(curve, data, values, free, low, high)


def _require_defined(problem: CurveProblem) -> None:
    """Raise InvalidInput, naming the first row, if a residual or slope at the start is no number to compute with."""
    block = problem.blocks(problem.values[problem.free])[0]
    numbers = np.concatenate([block.residuals[..., None], block.shared[0].values], axis=2)
    defined = np.asarray((np.abs(numbers) < LARGEST).all(axis=(1, 2)))
    if defined.all():
        return
    row = int(np.argmin(defined))
    columns = {name: column[row] for name, column in problem.data.columns.items()}
    where = ", ".join(f"{name}={value:g}" for name, value in columns.items()) or f"row {row + 1}"
    start = ", ".join(f"{n}={v:g}" for n, v in zip(problem.curve.parameters, problem.values, strict=True))
    count = int(np.count_nonzero(~defined))
    what = "too large to compute with" if np.isfinite(numbers[row]).all() else "not a number"
    raise InvalidInput(
        f"at the initial values {start} the model is {what} for {count} of {len(defined)} rows, first for {where}; "
        "choose another --start"
    )


@dataclass
class _Searches:
    """Runs from the start and further ones; counts them."""

    options: SearchOptions
    observe: Observe
    runs: int = 0

    def best(self, problem: CurveProblem) -> Found:
        """Return the lowest end of all runs; a later run must be lower by more than rounding errors."""
        stopping = self._stopping(problem)
        runs = ((start, method) for start in self._starts(problem) for method in self._methods(problem))
        best = self._run(problem, *next(runs), stopping)
        for start, method in runs:
            found = self._run(problem, start, method, stopping)
            if found.equations.cost < best.equations.cost - stopping.unseen(best.equations.cost):
                best = found
        return best

    def _run(self, problem: CurveProblem, start: Array, method: DenseMethod[Array], stopping: Stopping) -> Found:
        self.runs += 1
        run = self.runs
        return minimise_dense(problem, start, method, stopping, lambda turn: self.observe(run, turn))

    def _stopping(self, problem: CurveProblem) -> Stopping:
        # Nielsen's own factors; the search goes on to the rounding error, since fits are small
        return Stopping(1e-20, _ITERATIONS, damping=1e-3, least=1 / 3, rise=2.0, rounding=problem.rounding())

    def _methods(self, problem: CurveProblem) -> list[DenseMethod[Array]]:
        if self.options.method == "gauss-newton":
            return [DenseMethod(geodesic=False, full=True, room=problem.room)]
        return [DenseMethod(running, room=problem.room, residuals=problem.residuals) for running in (True, False)]

    def _starts(self, problem: CurveProblem) -> list[Array]:
        """Return the start and as many more as asked for, each element some powers of e larger or smaller."""
        first = problem.values[problem.free]
        rng = np.random.default_rng(self.options.seed)
        factors = np.exp(rng.normal(size=(self.options.restarts, len(first))))
        others = np.where(first == 0, np.log(factors), first * factors)
        others = np.clip(others, problem.low[problem.free], problem.high[problem.free])
        tried = ((start, linearise_dense(problem, start)) for start in others)
        return [first, *(start for start, equations in tried if equations and np.isfinite(equations.cost))]


def _search_with(problem: CurveProblem, name: str, searches: _Searches) -> Search:
    """Return the fit with a loss whose scale is that of the residuals it leaves; its problem has the fitted values."""
    kind, tuning = LOSSES[name]
    for _ in range(_ROUNDS):
        scale = _scale(problem)
        problem = replace(problem, loss=kind(tuning * scale))
        found = searches.best(problem)
        problem = replace(problem, values=problem.full(found.state))
        if abs(_scale(problem) - scale) <= _STEADY * scale:
            break
    return Search(problem, found, searches.runs, scale)


def _scale(problem: CurveProblem) -> float:
    """Return the standard deviation of residuals divided by sigma, at the problem's values: 1 where sigma is known."""
    if problem.data.sigma is not None:
        return 1.0
    residuals = problem.blocks(problem.values[problem.free])[0].residuals
    found = spread(residuals, problem.curve.components, problem.shared)
    return max(found, float(np.sqrt(2 * problem.rounding() / len(problem.data))), np.finfo(float).tiny)
