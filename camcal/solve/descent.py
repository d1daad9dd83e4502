"""The Levenberg–Marquardt loop: damped steps that lower the cost; a search computes the steps.

Its searches are those of `least_squares` (normal equations of an arrow, whose groups are eliminated) and `dense_search`
(orthogonal factors of the Jacobian itself). `independent` follows the same rules for many small problems at once.
Source: Marquardt 1963 (scaling of the damping); Nielsen, Damping Parameter in Marquardt's Method, 1999 (its update).
"""

import math
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from camcal.dataclass import dataclass
from camcal.solve.steps import SingularError, Step

State = TypeVar("State")
Number: TypeAlias = Any  # one number, or an array with one for each of many searches


class Equations(Protocol):
    """The linearised problem at a state; the loop reads the cost only."""

    @property
    def cost(self) -> float: ...


Linear = TypeVar("Linear", bound=Equations)


class Search(Protocol[State, Linear]):
    """What the loop requires of a problem and the way to solve its linear equations."""

    def linearise(self, state: State) -> Linear | None:
        """Return the equations at a state, or None where it is outside the domain."""
        ...

    def propose(self, state: State, equations: Linear, damping: float) -> tuple[Step, float]:
        """Return the damped step, and the decrease of the cost that the quadratic model promises.

        Raises SingularError if there is none.
        """
        ...

    def retract(self, state: State, step: Step) -> State:
        """Return the state moved by a step."""
        ...


REASONS = (
    "too many iterations",
    "converged",
    "stopped at the boundary of the domain",
    "converged (machine precision)",
    "converged (zero residuals)",
    "no step decreases the cost",
    "initial values outside the domain",
    "local minimum far above the lowest one",
)
RUNNING, SETTLED, HELD, ROUNDED, EXACT, STUCK, OUTSIDE, HOPELESS = range(len(REASONS))
BLOCKED, CRAWL = 5, 1e-4  # so many steps out of the domain, and this small a relative decrease: held at its edge
ALL_BUT_FULL = 1e-3  # below this damping a step is all but the full one
UNSEEN = 1e-13  # of the cost: a decrease that cannot be seen in it
LEAST_COST = 1e-300  # costs below count as this in what is relative to them


@dataclass(frozen=True)
class Stopping:
    """The rules of the loop, of one search (numbers) or of many at once (arrays of one shape).

    relative_decrease: how much the quadratic model must still predict, relative to the cost. iterations: at most.
    damping: of the first step. least: the factor that a step as good as promised lowers it by. rise: the first factor
    after a step that failed, which doubles with every further one. by_gain: whether the damping falls by how much of
    the promise came true (Nielsen), or always by `least` and rises always by `rise` (Marquardt). restart: the damping
    from which it rises at least. most: the one beyond which no step helps. rounding: a cost of residuals that are
    nothing but rounding errors. slack: the share of a cost by which a step may raise it and be taken, for costs summed
    in single precision.
    """

    relative_decrease: float = 1e-9
    iterations: int = 100
    damping: float = 1e-6
    least: float = 0.1
    rise: float = 10.0
    by_gain: bool = True
    restart: float = 1e-9
    most: float = 1e12
    rounding: float = 0.0
    slack: float = 0.0

    def unseen(self, cost: Number) -> Number:
        """Return how large a decrease of a cost may be and yet be hidden by its rounding error."""
        return np.maximum(UNSEEN * cost, self._blurred(cost))

    def little(self, cost: Number) -> Number:
        """Return the decrease below which no further step is worthwhile."""
        return np.maximum(self.relative_decrease * np.maximum(cost, LEAST_COST), self._blurred(cost))

    def _blurred(self, cost: Number) -> Number:
        # Cauchy–Schwarz: errors e of residuals r change the cost by r·e, at most ‖r‖ ‖e‖, of which half are usual
        return np.sqrt(cost * self.rounding) if self.rounding else 0.0

    def enough(self, damping: Number, promised: Number, cost: Number) -> Number:
        """Return whether a step that was taken to a cost promised so little that no further one is worthwhile."""
        # a step cut short by damping promises little and proves nothing
        return (damping < ALL_BUT_FULL) & (promised <= self.little(cost))

    def accepts(self, trial: Number, cost: Number) -> Number:
        """Return whether a step to the cost `trial` is taken; that of a place outside the domain is infinite."""
        return trial <= cost * (1 + self.slack)

    def end_of_taken(self, promised: Number, fall: Number, cost: Number, blocked: Number, enough: Number) -> Number:
        """Return why a search ends after a step that was taken, RUNNING where it goes on.

        cost: after the step, by `fall` lower. blocked: how many steps led out of the domain. enough: whether no further
        step is worthwhile.
        """
        still = (fall <= 0) & (promised <= self.unseen(cost))
        held = (blocked >= BLOCKED) & (fall <= CRAWL * cost)
        return np.where(enough, SETTLED, np.where(still, ROUNDED, np.where(held, HELD, RUNNING)))

    def end_of_refused(self, damping: Number, promised: Number, cost: Number, enough: Number = False) -> Number:
        """Return why a search ends after a step that was not taken, RUNNING where it goes on."""
        end = np.where(promised <= self.unseen(cost), ROUNDED, np.where(damping > self.most, STUCK, RUNNING))
        return np.where(enough, SETTLED, end)

    def eased(self, damping: Number, promised: Number, fall: Number) -> Number:
        """Return the damping after a step that was taken and lowered the cost by `fall`."""
        if not self.by_gain:
            return damping * self.least
        gain = np.where(promised > 0, fall / np.where(promised > 0, promised, 1.0), 1.0)
        return damping * np.maximum(self.least, 1 - (2 * np.minimum(gain, 1.0) - 1) ** 3)

    def raised(self, damping: Number, growth: Number) -> Number:
        """Return the damping after a step that was not taken; growth: 1, doubled by every one before it."""
        return np.maximum(damping, self.restart) * self.rise * (growth if self.by_gain else 1.0)


@dataclass(frozen=True)
class Iteration:
    """One turn of the loop.

    cost: before the step. trial_cost: after it, None outside the domain or without a step. gain: how much of the
    decrease that was promised came true. step: its length. accepted: whether the search went there.
    """

    number: int
    cost: float
    trial_cost: float | None
    damping: float
    gain: float | None
    step: float | None
    accepted: bool


Observer = Callable[[Iteration], None]


def unobserved(_: Iteration) -> None:
    """Observe nothing."""


@dataclass(frozen=True, eq=False)
class Descent(Generic[State, Linear]):
    """Where the loop ended: `converged`: whether at a minimum, `reason`: why."""

    state: State
    equations: Linear
    iterations: int
    converged: bool
    reason: str


STOPPING = Stopping()
_RAISED = "the full step raises the cost"


def descend(
    search: Search[State, Linear], state: State, stopping: Stopping = STOPPING, observe: Observer = unobserved
) -> Descent[State, Linear]:
    """Return where damped steps lead from `state`, which must be inside the domain; `observe` is told every turn.

    A minimum that lies on the edge of the domain counts as converged; its reason says so.
    """
    equations = search.linearise(state)
    if equations is None:
        raise ValueError("initial values outside the domain of the problem")
    damping, growth, blocked = stopping.damping, 1.0, 0
    for number in range(1, stopping.iterations + 1):
        try:
            step, promised = search.propose(state, equations, damping)
        except SingularError:
            observe(Iteration(number, equations.cost, None, damping, None, None, accepted=False))
            if damping > stopping.most:
                return Descent(state, equations, number - 1, False, "singular")
            damping, growth = max(damping, stopping.restart) * 2 * growth, growth * 2
            continue
        trial_state = search.retract(state, step)
        trial = search.linearise(trial_state)
        observe(_turn(number, equations, trial, damping, step, promised))
        blocked += trial is None
        if trial is not None and stopping.accepts(trial.cost, equations.cost):
            fall, enough = equations.cost - trial.cost, stopping.enough(damping, promised, trial.cost)
            end = stopping.end_of_taken(promised, fall, trial.cost, blocked, enough)
            state, equations, growth = trial_state, trial, 1.0
            damping = float(stopping.eased(damping, promised, fall))
        else:
            end = stopping.end_of_refused(damping, promised, equations.cost)
            damping, growth = float(stopping.raised(damping, growth)), growth * 2
        if end != RUNNING:
            return Descent(state, equations, number, bool(end != STUCK), REASONS[end])
    return Descent(state, equations, stopping.iterations, False, REASONS[RUNNING])


def gauss_newton(
    search: Search[State, Linear], state: State, stopping: Stopping = STOPPING, observe: Observer = unobserved
) -> Descent[State, Linear]:
    """Return where full steps lead until one raises the cost: the method of textbooks, to compare with.

    A step that raises the cost is not taken.
    """
    equations = search.linearise(state)
    if equations is None:
        raise ValueError("initial values outside the domain of the problem")
    for number in range(stopping.iterations):
        try:
            step, promised = search.propose(state, equations, 0.0)
        except SingularError:
            return Descent(state, equations, number, False, "singular")
        trial_state = search.retract(state, step)
        trial = search.linearise(trial_state)
        observe(_turn(number + 1, equations, trial, 0.0, step, promised))
        if trial is None or trial.cost > equations.cost:
            rounding = promised <= stopping.unseen(equations.cost)
            reason = REASONS[ROUNDED] if rounding else "the full step leaves the domain" if trial is None else _RAISED
            return Descent(state, equations, number + 1, bool(rounding), reason)
        state, equations = trial_state, trial
        if promised <= stopping.little(trial.cost):
            return Descent(state, equations, number + 1, True, REASONS[SETTLED])
    return Descent(state, equations, stopping.iterations, False, REASONS[RUNNING])


def _turn(
    number: int, here: Equations, trial: Equations | None, damping: float, step: Step, promised: float
) -> Iteration:
    length = math.sqrt(step.dot(step))
    if trial is None:
        return Iteration(number, here.cost, None, damping, None, length, accepted=False)
    gain = (here.cost - trial.cost) / promised if promised > 0 else None
    return Iteration(number, here.cost, trial.cost, damping, gain, length, accepted=trial.cost <= here.cost)
