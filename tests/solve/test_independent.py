"""Many small problems at once: each as if it were alone, and as the solver of one problem solves it."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest

from camcal.solve.descent import HELD, REASONS, RUNNING, Stopping
from camcal.solve.independent import Models, assemble, joined, minimise_each
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Cauchy
from camcal.solve.steps import Block, Jacobian

X = np.linspace(-1, 2, 30)


@dataclass(frozen=True)
class Decays:
    """y = a exp(b x), one curve a row; a state is (a, b). Outside the domain where b > limit."""

    y: np.ndarray
    loss: object = None
    weights: np.ndarray | None = None
    limit: float = np.inf

    def rows(self, states, which):
        a, b = states[:, :1], states[:, 1:]
        curve = np.exp(b * X)
        return np.stack([curve, a * X * curve, a * curve - self.y[which]])[None]

    def linearise(self, states, which):
        weights = None if self.weights is None else self.weights[which]
        models = assemble(self.rows(states, which), weights, self.loss)
        models.cost[states[:, 1] > self.limit] = np.inf
        return models

    def retract(self, states, steps):
        return states + steps


@dataclass(frozen=True)
class OneDecay:
    """The same for the solver of one problem."""

    y: np.ndarray
    loss: object

    shared = 2
    groups = (0, 0)

    def blocks(self, state):
        rows = Decays(self.y[None]).rows(state[None], np.zeros(1, int))[0, :, 0]
        return [Block(rows[2][:, None], (Jacobian(rows[:2].T[:, None], np.arange(2)),), loss=self.loss)]

    def retract(self, state, step):
        return state + step.shared


def curves(rng, count, noise):
    truth = np.column_stack([rng.uniform(0.5, 3, count), rng.uniform(-2, 1, count)])
    return truth, truth[:, :1] * np.exp(truth[:, 1:] * X) + noise * rng.standard_normal((count, len(X)))


@pytest.mark.parametrize("loss", [None, Cauchy(0.2)], ids=["squares", "cauchy"])
def test_each_problem_reaches_the_minimum_that_the_solver_of_one_finds(loss):
    rng = np.random.default_rng(1)
    truth, y = curves(rng, 20, 0.1)
    found = minimise_each(Decays(y, loss), truth + 0.2, np.arange(20), Stopping(relative_decrease=1e-12))
    for state, cost, row, start in zip(found.states, found.cost, y, truth + 0.2, strict=True):
        alone = minimise(OneDecay(row, loss), start, Stopping(relative_decrease=1e-12))
        np.testing.assert_allclose(state, alone.state, atol=1e-5)  # the square root of the stopping rule
        assert cost == pytest.approx(alone.cost, rel=1e-9)
    assert found.converged.all()


def test_a_problem_does_not_feel_the_others():
    rng = np.random.default_rng(2)
    truth, y = curves(rng, 6, 0.1)
    y[3] *= 5  # needs more steps than the rest
    together = minimise_each(Decays(y), truth + 0.3, np.arange(6))
    for index in range(6):
        alone = minimise_each(Decays(y), truth[[index]] + 0.3, np.array([index]))
        np.testing.assert_array_equal(alone.states[0], together.states[index])
        assert alone.iterations[0] == together.iterations[index]
    assert len(set(together.iterations.tolist())) > 1


def test_one_problem_may_be_started_several_times():
    rng = np.random.default_rng(3)
    truth, y = curves(rng, 2, 0.05)
    found = minimise_each(Decays(y), truth[[0, 0, 1]] + [[0.1, 0.1], [-0.2, 0.3], [0, 0.2]], np.array([0, 0, 1]))
    np.testing.assert_allclose(found.states[0], found.states[1], atol=1e-4)
    both = joined(found.take(np.array([2])), found.take(np.array([0])))
    np.testing.assert_array_equal(both.states, found.states[[2, 0]])
    np.testing.assert_array_equal(both.which, [1, 0])


def test_weights_of_zero_leave_rows_out():
    rng = np.random.default_rng(4)
    truth, y = curves(rng, 3, 0.05)
    spoilt, weights = y.copy(), np.ones_like(y)
    spoilt[:, 5], weights[:, 5] = 99.0, 0.0
    clean = minimise_each(Decays(y, weights=weights), truth, np.arange(3))
    found = minimise_each(Decays(spoilt, weights=weights), truth, np.arange(3))
    np.testing.assert_allclose(found.states, clean.states, rtol=1e-12)


def test_every_search_says_why_it_ended():
    rng = np.random.default_rng(5)
    _, noisy = curves(rng, 1, 0.1)
    exact = np.exp(X)[None]  # a = 1, b = 1
    y = np.concatenate([noisy, exact, exact, exact])
    starts = np.array([[1.0, 0.0], [0.5, 0.5], [1.0, 2.0], [1.0, 0.0]])
    ends = minimise_each(Decays(y, limit=1.5), starts, np.arange(4), exact=1e-20)
    reasons = [REASONS[index] for index in ends.reason]
    assert reasons[:3] == [
        "converged",
        "converged (zero residuals)",
        "initial values outside the domain",
    ]
    assert ends.converged.tolist() == [True, True, False, True]
    held = minimise_each(Decays(exact, limit=0.5), starts[3:], np.zeros(1, int))
    assert REASONS[held.reason[0]] == "stopped at the boundary of the domain"
    assert held.states[0, 1] == pytest.approx(0.5, abs=0.05)  # where the crawl is called off
    short = minimise_each(Decays(noisy), starts[:1] + 3, np.zeros(1, int), Stopping(iterations=1))
    assert REASONS[short.reason[0]] == "too many iterations"


@pytest.mark.parametrize("damping", [1e-6, 1e-3, 1.0])
def test_a_search_that_starts_at_its_minimum_ends_there_whatever_its_damping(damping):
    _, y = curves(np.random.default_rng(6), 200, 0.1)
    starts = minimise_each(Decays(y), np.ones((200, 2)), np.arange(200), Stopping(relative_decrease=1e-30)).states
    found = minimise_each(Decays(y), starts, np.arange(200), Stopping(damping=damping))
    assert found.converged.all()
    assert found.iterations.max() < 20


def test_a_search_ends_where_its_caller_has_enough():
    _, y = curves(np.random.default_rng(7), 50, 0.1)
    seen = []

    def enough(tried):
        seen.append(tried)
        return np.abs(tried.steps).max(axis=1) < 0.05

    starts = np.ones((50, 2))
    found = minimise_each(Decays(y), starts, np.arange(50), Stopping(), enough=enough)
    usual = minimise_each(Decays(y), starts, np.arange(50), Stopping())
    assert found.converged.all()
    assert (found.iterations <= usual.iterations).all()
    assert found.iterations.sum() < usual.iterations.sum()
    assert np.abs(found.steps).max() < 0.05
    np.testing.assert_allclose(found.states, usual.states, atol=0.01)
    first = seen[0]
    np.testing.assert_allclose(first.before.cost, Decays(y).linearise(starts, np.arange(50)).cost)
    assert (first.taken == (first.fall >= 0)).all()


def test_costs_that_are_rounded_need_slack():
    """A cost that is known to some digits only rises by chance: steps are refused next to the minimum unless it may."""
    _, y = curves(np.random.default_rng(8), 40, 0.1)

    class Rounded(Decays):
        def linearise(self, states, which):
            models = super().linearise(states, which)
            noise = 1 + 1e-4 * np.sin(1e7 * states.sum(axis=1))
            return Models(models.cost * noise, models.gradient, models.normal)

    exact = minimise_each(Decays(y), np.ones((40, 2)), np.arange(40), Stopping(1e-14))
    ends = [
        minimise_each(Rounded(y), np.ones((40, 2)), np.arange(40), Stopping(1e-10, 60, slack=slack))
        for slack in (0.0, 1e-3)
    ]
    strict, slack = (np.abs(end.states - exact.states).max(axis=1) for end in ends)
    assert slack.max() < 1e-5
    assert strict.max() > 10 * slack.max()


def test_damping_may_follow_fixed_factors_to_the_same_minimum():
    _, y = curves(np.random.default_rng(9), 1, 0.1)
    fixed, turns = Stopping(damping=1e-2, least=0.25, rise=7.0, by_gain=False, restart=0.0), []
    start = np.array([1.0, 3.0])
    found = minimise(OneDecay(y[0], None), start, fixed, turns.append)
    factors = [after.damping / before.damping for before, after in pairwise(turns)]
    np.testing.assert_allclose(factors, [0.25 if turn.accepted else 7.0 for turn in turns[:-1]])
    assert len(set(np.round(factors, 6))) == 2
    np.testing.assert_allclose(found.state, minimise(OneDecay(y[0], None), start).state, atol=1e-4)
    together = minimise_each(Decays(y), start[None], np.zeros(1, int), fixed)
    np.testing.assert_allclose(together.states[0], found.state, atol=1e-6)
    assert together.iterations[0] == found.iterations


def test_a_parameter_that_nothing_depends_on_stays():
    class Half:
        def linearise(self, states, which):
            residual = states[:, 0] - 2.0
            normal = np.zeros((len(states), 2, 2))
            normal[:, 0, 0] = 1.0
            return Models(0.5 * residual**2, np.column_stack([residual, 0 * residual]), normal)

        def retract(self, states, steps):
            return states + steps

    found = minimise_each(Half(), np.array([[0.0, 7.0], [1.0, 8.0]]), np.arange(2))
    np.testing.assert_allclose(found.states, [[2, 7], [2, 8]], atol=1e-6)


def test_searches_far_above_another_of_their_problem_end_early_and_no_others():
    """Two wells, the one at x near 1 being the higher; the second problem has a level that makes both alike."""
    starts = np.array([[-2.0], [2.0], [-2.0], [2.0]])
    which = np.array([0, 0, 1, 1])
    wells = Wells(np.array([0.0, 30.0]))
    full = minimise_each(wells, starts, which)
    early = minimise_each(wells, starts, which, worth=np.full(4, 10.0))
    assert full.converged.all()
    np.testing.assert_array_equal(early.converged, [True, False, True, True])
    assert REASONS[early.reason[1]] == "local minimum far above the lowest one"
    np.testing.assert_array_equal(early.states[[0, 2, 3]], full.states[[0, 2, 3]])
    assert early.cost[1] > 10 * early.cost[0]


@dataclass(frozen=True)
class Wells:
    """Residuals x² - 1, (x + 1) / 2 and a level, one of each problem."""

    level: np.ndarray

    def linearise(self, states, which):
        x = states[:, 0]
        residuals = np.stack([x**2 - 1, (x + 1) / 2, self.level[which]])
        slopes = np.stack([2 * x, np.full_like(x, 0.5), np.zeros_like(x)])
        rows = np.stack([slopes, residuals]).transpose(0, 2, 1)[None]
        return assemble(rows)

    def retract(self, states, steps):
        return states + steps


@pytest.mark.parametrize(("blocked", "fall", "end"), [(4, 1e-5, RUNNING), (5, 1e-5, HELD), (5, 1e-3, RUNNING)])
def test_a_search_is_held_that_left_the_domain_five_times_and_hardly_gets_on(blocked, fall, end):
    assert Stopping().end_of_taken(1.0, fall, 1.0, blocked, enough=False) == end
