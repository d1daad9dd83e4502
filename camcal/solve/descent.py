"""The Levenberg–Marquardt loop: steps that are damped until they lower the cost; how a step is found is the search's.

Its searches are those of `least_squares` (normal equations of an arrow, whose groups are eliminated) and `dense_search`
(orthogonal factors of the Jacobian itself). `independent` follows the same rules for many small problems at once.
Source: Marquardt 1963 (scaling of the damping); Nielsen, Damping Parameter in Marquardt's Method, 1999 (its update).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from camcal.solve.steps import SingularError, Step

State = TypeVar("State")


class Equations(Protocol):
    """The linearised problem at a state; the loop reads the cost only."""

    @property
    def cost(self) -> float: ...


Linear = TypeVar("Linear", bound=Equations)


@dataclass(frozen=True, eq=False)
class Proposal:
    """A step, and by how much the quadratic model says that it lowers the cost."""

    step: Step
    promised: float


class Search(Protocol[State, Linear]):
    """What the loop asks of a problem and the way to solve its linear equations."""

    def linearise(self, state: State) -> Linear | None:
        """Return the equations at a state, or None where it is outside the domain."""
        ...

    def propose(self, state: State, equations: Linear, damping: float) -> Proposal:
        """Return the damped step; raises SingularError if there is none."""
        ...

    def retract(self, state: State, step: Step) -> State:
        """Return the state moved by a step."""
        ...


@dataclass(frozen=True)
class Stopping:
    """When to stop: the decrease that the quadratic model still promises, relative to the cost; the iterations.

    damping: of the first step. least: the factor that a step as good as promised lowers it by. rise: the first factor
    after a step that failed, which doubles with every further one. rounding: a cost of residuals that are nothing but
    rounding errors.
    """

    relative_decrease: float = 1e-9
    iterations: int = 100
    damping: float = 1e-6
    least: float = 0.1
    rise: float = 10.0
    rounding: float = 0.0

    def unseen(self, cost: float) -> float:
        """Return how large a decrease of a cost may be and yet be hidden by its rounding error."""
        return max(UNSEEN * cost, self._blurred(cost))

    def little(self, cost: float) -> float:
        """Return the decrease below which no further step is worth its while."""
        return max(self.relative_decrease * max(cost, LEAST_COST), self._blurred(cost))

    def _blurred(self, cost: float) -> float:
        # Cauchy–Schwarz: errors e of residuals r change the cost by r·e, at most ‖r‖ ‖e‖, of which half are usual
        return math.sqrt(cost * self.rounding)


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
    """Look at no turn."""


@dataclass(frozen=True, eq=False)
class Descent(Generic[State, Linear]):
    """Where the loop ended: `converged` says whether at a minimum, `reason` says why."""

    state: State
    equations: Linear
    iterations: int
    converged: bool
    reason: str


STOPPING = Stopping()
MAX_DAMPING, RESTART_DAMPING = 1e12, 1e-9  # beyond the first no step helps; below the second growth begins there
BLOCKED, CRAWL = 5, 1e-4  # so many steps out of the domain, and this small a relative decrease: held at its edge
ALL_BUT_FULL = 1e-3  # below this damping a step is all but the full one
UNSEEN = 1e-13  # of the cost: a decrease that cannot be seen in it
LEAST_COST = 1e-300  # costs below count as this in what is relative to them
_HELD = "held at the edge of the domain"
_RAISED = "the full step raises the cost"
_SETTLED, _ROUNDING = "the step promises no decrease", "the cost is at its rounding error"


def descend(
    search: Search[State, Linear], state: State, stopping: Stopping = STOPPING, observe: Observer = unobserved
) -> Descent[State, Linear]:
    """Return where damped steps lead from `state`, which must be inside the domain; `observe` is told every turn.

    A minimum that lies on the edge of the domain counts as converged; its reason says so.
    """
    equations = search.linearise(state)
    if equations is None:
        raise ValueError("the start is outside the domain of the problem")
    damping, growth, blocked = stopping.damping, 1.0, 0
    for number in range(stopping.iterations):
        try:
            proposal = search.propose(state, equations, damping)
        except SingularError:
            observe(Iteration(number + 1, equations.cost, None, damping, None, None, accepted=False))
            if damping > MAX_DAMPING:
                return Descent(state, equations, number, False, "singular")
            damping, growth = max(damping, RESTART_DAMPING) * 2 * growth, growth * 2
            continue
        promised = proposal.promised
        trial_state = search.retract(state, proposal.step)
        trial = search.linearise(trial_state)
        observe(_turn(number + 1, equations, trial, damping, proposal))
        blocked += trial is None
        if trial is not None and trial.cost <= equations.cost:
            fall = equations.cost - trial.cost
            # a step cut short by damping promises little and proves nothing
            settled = damping < ALL_BUT_FULL and promised <= stopping.little(trial.cost)
            still = fall <= 0 and promised <= stopping.unseen(trial.cost)
            held = blocked >= BLOCKED and fall <= CRAWL * trial.cost
            state, equations, growth = trial_state, trial, 1.0
            damping *= max(stopping.least, 1 - (2 * min(fall / promised if promised > 0 else 1.0, 1.0) - 1) ** 3)
            if settled or still or held:
                reason = _SETTLED if settled else _ROUNDING if still else _HELD
                return Descent(state, equations, number + 1, True, reason)
        elif promised <= stopping.unseen(equations.cost):
            return Descent(state, equations, number + 1, True, _ROUNDING)
        elif damping > MAX_DAMPING:
            return Descent(state, equations, number + 1, False, "no step lowers the cost")
        else:
            damping, growth = max(damping, RESTART_DAMPING) * stopping.rise * growth, growth * 2
    return Descent(state, equations, stopping.iterations, False, "too many iterations")


def gauss_newton(
    search: Search[State, Linear], state: State, stopping: Stopping = STOPPING, observe: Observer = unobserved
) -> Descent[State, Linear]:
    """Return where full steps lead until one raises the cost: the method of textbooks, to compare with.

    A step that raises the cost is not taken.
    """
    equations = search.linearise(state)
    if equations is None:
        raise ValueError("the start is outside the domain of the problem")
    for number in range(stopping.iterations):
        try:
            proposal = search.propose(state, equations, 0.0)
        except SingularError:
            return Descent(state, equations, number, False, "singular")
        trial_state = search.retract(state, proposal.step)
        trial = search.linearise(trial_state)
        observe(_turn(number + 1, equations, trial, 0.0, proposal))
        if trial is None or trial.cost > equations.cost:
            rounding = proposal.promised <= stopping.unseen(equations.cost)
            reason = _ROUNDING if rounding else "the full step leaves the domain" if trial is None else _RAISED
            return Descent(state, equations, number + 1, rounding, reason)
        state, equations = trial_state, trial
        if proposal.promised <= stopping.little(trial.cost):
            return Descent(state, equations, number + 1, True, _SETTLED)
    return Descent(state, equations, stopping.iterations, False, "too many iterations")


def _turn(number: int, here: Equations, trial: Equations | None, damping: float, proposal: Proposal) -> Iteration:
    length = math.sqrt(proposal.step.dot(proposal.step))
    if trial is None:
        return Iteration(number, here.cost, None, damping, None, length, accepted=False)
    gain = (here.cost - trial.cost) / proposal.promised if proposal.promised > 0 else None
    return Iteration(number, here.cost, trial.cost, damping, gain, length, accepted=trial.cost <= here.cost)
