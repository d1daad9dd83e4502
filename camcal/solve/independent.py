"""Many small least-squares problems at once: the loop of descent.py with a damping and an end for each of them.

Damping, acceptance and ends are the rules of that loop (Stopping); steps come from each problem's own normal equations.
One pass over the arrays of all problems takes the place of a loop over problems, which costs more in calls than in
arithmetic when a problem has a hundred residuals and six parameters.
Source: as descent.py.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.solve.descent import (
    ALL_BUT_FULL,
    EXACT,
    HELD,
    HOPELESS,
    OUTSIDE,
    REASONS,
    ROUNDED,
    RUNNING,
    SETTLED,
    STOPPING,
    Stopping,
)
from camcal.solve.losses import Loss

_CONVERGED = np.isin(np.arange(len(REASONS)), [SETTLED, HELD, ROUNDED, EXACT])
_REACH = 1000.0  # times what an undamped step promises: further down, a search does not come
_TINY = np.finfo(float).tiny
_LEAST_DAMPING = 1e-12  # keeps the factors of a singular matrix real


@dataclass(frozen=True, eq=False)
class Models:
    """The quadratic models of W costs ½ Σ ρ, of P parameters each: cost (W,), gradient (W, P), normal (W, P, P).

    The cost is infinite where a state is outside its problem's domain.
    """

    cost: Array
    gradient: Array
    normal: Array

    def take(self, chosen: Array) -> "Models":
        """Return some of the models."""
        return Models(self.cost[chosen], self.gradient[chosen], self.normal[chosen])

    def put(self, at: Array, other: "Models") -> None:
        """Replace the models `at` by the others."""
        self.cost[at], self.gradient[at], self.normal[at] = other.cost, other.gradient, other.normal


class Problems(Protocol):
    """What the solver requires of the problems; states are an array whose first axis runs over them."""

    def linearise(self, states: Array, which: Array) -> Models:
        """Return the models at the states (W, …) of the problems `which` (W,)."""
        ...

    def retract(self, states: Array, steps: Array) -> Array:
        """Return the states moved by steps (W, P)."""
        ...


@dataclass(frozen=True, eq=False)
class Trial:
    """Steps (A, P) of the problems `which` (A,) from `before`: by how much (A,) the models promise that they lower the
    costs and by how much they do, and which of them (A,) were taken.
    """

    steps: Array
    which: Array
    before: Models
    promised: Array
    fall: Array
    taken: Array


Enough = Callable[[Trial], Array]


@dataclass(frozen=True, eq=False)
class Minima:
    """Where the searches ended: states (S, …), which problem (S,) each belongs to, models, iterations (S,), the mask
    (S,) of those at a minimum, why they stopped, as indices (S,) into REASONS, their last steps (S, P), taken or not.
    """

    states: Array
    which: Array
    models: Models
    iterations: Array
    converged: Array
    reason: Array
    steps: Array

    @property
    def cost(self) -> Array:
        """The costs (S,), infinite where the start was outside the domain."""
        return self.models.cost

    def take(self, chosen: Array) -> "Minima":
        """Return some of the searches."""
        ends = self.iterations[chosen], self.converged[chosen], self.reason[chosen], self.steps[chosen]
        return Minima(self.states[chosen], self.which[chosen], self.models.take(chosen), *ends)


def joined(first: Minima, second: Minima) -> Minima:
    """Return the searches of both."""
    one, other = first.models, second.models
    models = Models(
        np.concatenate([one.cost, other.cost]),
        np.concatenate([one.gradient, other.gradient]),
        np.concatenate([one.normal, other.normal]),
    )
    return Minima(
        np.concatenate([first.states, second.states]),
        np.concatenate([first.which, second.which]),
        models=models,
        iterations=np.concatenate([first.iterations, second.iterations]),
        converged=np.concatenate([first.converged, second.converged]),
        reason=np.concatenate([first.reason, second.reason]),
        steps=np.concatenate([first.steps, second.steps]),
    )


def assemble(rows: Array, weights: Array | None = None, loss: Loss | None = None) -> Models:
    """Return the models of residuals and their derivatives.

    rows: (D, P + 1, W, R), the P derivatives and then the residual, of R rows of D coordinates for each of W problems,
    so that the long axes come last; they are weighted in place. weights: (W, R) inverse variances. loss: of the
    weighted squared residual.
    """
    cost = None
    if loss is not None:
        squared = np.einsum("dwr,dwr->wr", rows[:, -1], rows[:, -1])
        squared = squared if weights is None else squared * weights
        cost = 0.5 * loss.cost(squared).sum(axis=1)
        weights = loss.weight(squared) * (1.0 if weights is None else weights)
    if weights is not None:
        rows *= np.sqrt(weights)
    gram = np.zeros((rows.shape[2], rows.shape[1], rows.shape[1]))
    for part in rows.transpose(0, 2, 1, 3):
        gram += part @ part.transpose(0, 2, 1)
    return Models(0.5 * gram[:, -1, -1] if cost is None else cost, gram[:, :-1, -1], gram[:, :-1, :-1])


def minimise_each(
    problems: Problems,
    states: Array,
    which: Array,
    stopping: Stopping = STOPPING,
    exact: Array | float = 0.0,
    worth: Array | float = np.inf,
    enough: Enough | None = None,
) -> Minima:
    """Return the states that minimise ½ Σ ρ(‖r‖²) of the problems `which` (S,), each started at its state (S, …).

    A problem may be started several times. exact: the costs, (S,) or one, below which residuals are all rounding.
    worth: how many times, (S,) or one, the lowest cost of the same problem a minimum may be; searches that will not
    come down to that end early. enough: after which steps (A,) no further one is worthwhile, by default those that
    were taken and promised little.
    """
    search = _Search.of(problems, states, which, stopping=stopping, exact=exact, worth=worth, enough=enough)
    for _ in range(stopping.iterations):
        alive = np.flatnonzero(search.reason == RUNNING)
        if not alive.size:
            break
        search.advance(alive)
    converged = _CONVERGED[search.reason]
    return Minima(
        search.states,
        which,
        models=search.models,
        iterations=search.iterations,
        converged=converged,
        reason=search.reason,
        steps=search.steps,
    )


@dataclass(eq=False)
class _Search:
    """The searches under way: what each has reached, its damping, and why it stopped (0: it has not)."""

    problems: Problems
    which: Array
    stopping: Stopping
    exact: Array
    worth: Array
    enough: Enough | None
    states: Array
    models: Models
    damping: Array
    growth: Array
    blocked: Array
    iterations: Array
    reason: Array
    steps: Array

    @classmethod
    def of(
        cls,
        problems: Problems,
        states: Array,
        which: Array,
        stopping: Stopping,
        exact: Array | float,
        worth: Array | float,
        enough: Enough | None,
    ) -> "_Search":
        models, count = problems.linearise(states, which), len(which)
        limits, factors = (np.broadcast_to(np.asarray(each, dtype=float), (count,)) for each in (exact, worth))
        reason = np.where(np.isfinite(models.cost), np.where(models.cost <= limits, EXACT, RUNNING), OUTSIDE)
        return cls(
            problems,
            which,
            stopping=stopping,
            exact=limits,
            worth=factors,
            enough=enough,
            states=states.copy(),
            models=models,
            damping=np.full(count, stopping.damping),
            growth=np.ones(count),
            blocked=np.zeros(count, np.intp),
            iterations=np.zeros(count, np.intp),
            reason=reason,
            steps=np.zeros_like(models.gradient),
        )

    def advance(self, alive: Array) -> None:
        """Take one step of the searches `alive` (A,), or find that it leads nowhere and damp the next one more."""
        steps, promised = self._propose(alive)
        hopeless = self._hopeless(alive, promised)
        if hopeless.any():
            self.reason[alive[hopeless]] = HOPELESS
            alive, steps, promised = alive[~hopeless], steps[~hopeless], promised[~hopeless]
            if not alive.size:
                return
        self.steps[alive] = steps
        states = self.problems.retract(self.states[alive], steps)
        trial = self.problems.linearise(states, self.which[alive])
        self.iterations[alive] += 1
        self.blocked[alive] += ~np.isfinite(trial.cost)
        cost, before = trial.cost, self.models.cost[alive]
        better = self.stopping.accepts(cost, before)
        if self.enough is None:
            enough = self.stopping.enough(self.damping[alive], promised, cost) & better
        else:
            enough = self.enough(
                Trial(steps, self.which[alive], self.models.take(alive), promised, before - cost, better)
            )
        if better.all():
            self._accept(alive, states, trial, promised, enough)
            return
        self._reject(alive[~better], promised[~better], enough[~better])
        if better.any():
            self._accept(alive[better], states[better], trial.take(better), promised[better], enough[better])

    def _hopeless(self, alive: Array, promised: Array) -> Array:
        """Return the mask (A,) of searches that will stay far above another one of their problems."""
        if len(self.which) == 1 or np.isinf(self.worth[0]):
            return np.zeros(len(alive), dtype=bool)
        lowest = np.full(int(self.which.max()) + 1, np.inf)
        np.minimum.at(lowest, self.which, self.models.cost)
        bound = self.models.cost[alive] - _REACH * promised
        return np.asarray(
            (bound > self.worth[alive] * lowest[self.which[alive]]) & (self.damping[alive] < ALL_BUT_FULL)
        )

    def _propose(self, alive: Array) -> tuple[Array, Array]:
        """Return the damped steps (A, P) and the predicted decreases (A,) of the costs."""
        normal, gradient = self.models.normal[alive], self.models.gradient[alive]
        diagonal = np.einsum("wii->wi", normal)
        largest = np.maximum(diagonal.max(axis=1, keepdims=True), _TINY)
        # a parameter no residual depends on must not make the damped matrix singular
        scale = 1 / np.sqrt(np.maximum(diagonal, 1e-12 * largest))
        scaled = normal * scale[:, :, None] * scale[:, None, :]
        on_diagonal = np.einsum("wii->wi", scaled)
        on_diagonal += self.damping[alive, None]
        steps = -scale * np.linalg.solve(scaled, (scale * gradient)[..., None])[..., 0]
        return steps, -0.5 * np.einsum("wi,wi->w", steps, gradient)

    def _accept(self, at: Array, states: Array, trial: Models, promised: Array, enough: Array) -> None:
        cost, damping = trial.cost, self.damping[at]
        fall = self.models.cost[at] - cost
        end = self.stopping.end_of_taken(promised, fall, cost, self.blocked[at], enough)
        self.reason[at] = np.where(cost <= self.exact[at], EXACT, end)
        floor = min(_LEAST_DAMPING, self.stopping.restart)
        self.damping[at], self.growth[at] = np.maximum(self.stopping.eased(damping, promised, fall), floor), 1.0
        self.states[at] = states
        self.models.put(at, trial)

    def _reject(self, at: Array, promised: Array, enough: Array) -> None:
        self.reason[at] = self.stopping.end_of_refused(self.damping[at], promised, self.models.cost[at], enough)
        self.damping[at] = self.stopping.raised(self.damping[at], self.growth[at])
        self.growth[at] *= 2
