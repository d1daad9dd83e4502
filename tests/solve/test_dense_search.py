"""The dense search on problems of Moré, Garbow and Hillstrom (1981), under bounds, and turn by turn."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from camcal.solve.dense import DenseMethod, linearise_dense, minimise_dense
from camcal.solve.descent import Stopping
from camcal.solve.differentiate import complex_jacobian
from camcal.solve.least_squares import minimise
from camcal.solve.losses import Huber
from camcal.solve.steps import Block, Jacobian

EXACT = Stopping(1e-20, 300, damping=1e-3, least=1 / 3, rise=2.0, rounding=1e-26)
METHODS = [DenseMethod(), DenseMethod(running_scale=False), DenseMethod(geodesic=False)]


@dataclass(frozen=True)
class Problem:
    """Residuals of a vector that take complex numbers; differentiated by complex steps."""

    function: object
    shared: int
    loss: object = None
    groups = (0, 0)

    def blocks(self, state):
        with np.errstate(all="ignore"):
            values, slopes = self.function(state), complex_jacobian(self.function, state)
        return [Block(values[:, None], (Jacobian(slopes[:, None], np.arange(self.shared)),), loss=self.loss)]

    def retract(self, state, step):
        return state + step.shared


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def freudenstein_roth(x):
    return np.array([-13 + x[0] + ((5 - x[1]) * x[1] - 2) * x[1], -29 + x[0] + ((x[1] + 1) * x[1] - 14) * x[1]])


def powell_badly_scaled(x):
    return np.array([1e4 * x[0] * x[1] - 1, np.exp(-x[0]) + np.exp(-x[1]) - 1.0001])


def brown_badly_scaled(x):
    return np.array([x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2])


def beale(x):
    return np.array([1.5 - x[0] * (1 - x[1]), 2.25 - x[0] * (1 - x[1] ** 2), 2.625 - x[0] * (1 - x[1] ** 3)])


def box(x):
    t = 0.1 * np.arange(1, 11)
    return np.exp(-t * x[0]) - np.exp(-t * x[1]) - x[2] * (np.exp(-t) - np.exp(-10 * t))


def powell_singular(x):
    return np.array(
        [x[0] + 10 * x[1], np.sqrt(5) * (x[2] - x[3]), (x[1] - 2 * x[2]) ** 2, np.sqrt(10) * (x[0] - x[3]) ** 2]
    )


def kowalik_osborne(x):
    y = np.array([0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246])
    u = np.array([4, 2, 1, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625])
    return y - x[0] * (u**2 + u * x[1]) / (u**2 + u * x[2] + x[3])


def jennrich_sampson(x):
    i = np.arange(1, 11)
    return 2 + 2 * i - (np.exp(i * x[0]) + np.exp(i * x[1]))


# problem, start, sums of squares of its minima (several where it has local ones)
CLASSICS = {
    "Rosenbrock": (rosenbrock, [-1.2, 1.0], [0.0]),
    "Freudenstein and Roth": (freudenstein_roth, [0.5, -2.0], [0.0, 48.98425]),
    "Powell, badly scaled": (powell_badly_scaled, [0.0, 1.0], [0.0]),
    "Brown, badly scaled": (brown_badly_scaled, [1.0, 1.0], [0.0]),
    "Beale": (beale, [1.0, 1.0], [0.0]),
    "Jennrich and Sampson": (jennrich_sampson, [0.3, 0.4], [124.3621824]),
    "Box, three dimensions": (box, [0.0, 10.0, 20.0], [0.0]),
    "Powell, singular": (powell_singular, [3.0, -1.0, 0.0, 1.0], [0.0]),
    "Kowalik and Osborne": (kowalik_osborne, [0.25, 0.39, 0.415, 0.39], [3.0750561e-4]),
}


@pytest.mark.parametrize("method", METHODS, ids=["running scale", "present scale", "straight"])
@pytest.mark.parametrize("name", CLASSICS)
def test_classic_problems_are_solved_from_their_standard_starts(name, method):
    function, start, minima = CLASSICS[name]
    problem = Problem(function, len(start))
    found = minimise_dense(problem, np.array(start), method, EXACT)
    squares = 2 * found.equations.cost
    # published to seven digits; where it is zero, residuals made of numbers near 1e6 are known to 1e-9
    assert min(abs(squares - minimum) for minimum in minima) <= max(2e-7 * squares, 1e-17)


def line(count=20):
    rng = np.random.default_rng(2)
    x = rng.normal(size=count)
    y = 3 * x - 1 + 0.1 * rng.normal(size=count)
    return Problem(lambda p: p[0] * x + p[1] - y, 2), np.polyfit(x, y, 1)


def test_a_linear_problem_takes_one_full_step():
    problem, expected = line()
    found = minimise_dense(problem, np.array([100.0, -50.0]), DenseMethod(full=True))
    np.testing.assert_allclose(found.state, expected, atol=1e-12)
    assert found.converged
    assert found.iterations <= 2  # the second sees that nothing is left to gain


@pytest.mark.parametrize("method", [*METHODS, DenseMethod(full=True)], ids=["running", "present", "straight", "full"])
def test_a_minimum_is_recognised_whatever_the_sign_of_the_rounding_error_of_the_decrease(method):
    rng = np.random.default_rng(5)
    ends = []
    for _ in range(150):
        count = int(rng.integers(3, 5))
        x = rng.choice(np.arange(-5.0, 11.0), count, replace=False)
        y = np.polyval(10.0 ** rng.integers(-3, 4) * rng.normal(size=2), x)
        y += 10.0 ** rng.integers(-16, 1) * np.abs(y).max() * rng.normal(size=count)
        problem = Problem(lambda p, x=x, y=y: p[0] * x + p[1] - y, 2)
        rounding = 0.5 * np.sum((np.finfo(float).eps * y) ** 2)
        stopping = replace(EXACT, rounding=float(rounding))
        ends.append(minimise_dense(problem, np.polyfit(x, y, 1), method, stopping))
    assert {end.reason for end in ends if not end.converged} == set()


def test_the_decrease_promised_under_bounds_is_that_of_the_quadratic_model():
    rng = np.random.default_rng(6)
    for _ in range(20):
        jacobian, data, limit = rng.normal(size=(6, 3)), rng.normal(size=6), rng.uniform(0, 0.5, 3)
        problem = Problem(lambda p, jacobian=jacobian, data=data: jacobian @ p - data, 3)
        method = DenseMethod(geodesic=False, room=lambda state, limit=limit: (-limit - state, limit - state))
        turns = []
        found = minimise_dense(problem, np.zeros(3), method, EXACT, turns.append)
        assert found.converged
        gains = [turn.gain for turn in turns if turn.accepted and turn.cost - turn.trial_cost > 1e-6 * turn.cost]
        assert gains == pytest.approx(np.ones(len(gains)), rel=1e-8)  # what is left of differences of 1e-6


def test_the_dense_step_finds_what_the_normal_equations_find():
    problem, _ = line()
    robust = Problem(problem.function, 2, Huber(0.1))
    for each in (problem, robust):
        dense = minimise_dense(each, np.zeros(2), DenseMethod(), EXACT)
        arrow = minimise(each, np.zeros(2), Stopping(1e-16))
        np.testing.assert_allclose(dense.state, arrow.state, atol=1e-8)  # where the arrow's promise ends
        assert dense.equations.cost == pytest.approx(arrow.cost, rel=1e-12)


def test_bounds_are_kept_at_every_turn_and_the_rest_is_fitted_inside_them():
    problem, _ = line()
    visited = []

    def watched(p):
        visited.append(p.real)
        return problem.function(p)

    method = DenseMethod(room=lambda state: (np.array([-5.0, -5.0]) - state, np.array([2.0, 5.0]) - state))
    found = minimise_dense(Problem(watched, 2), np.zeros(2), method, EXACT)
    assert max(state[0] for state in visited) <= 2.0 + 1e-15
    assert found.state[0] == pytest.approx(2.0, abs=1e-15)
    held = Problem(lambda p: problem.function(np.array([2.0, p[0]])), 1)
    alone = minimise_dense(held, np.zeros(1), DenseMethod(), EXACT)
    assert found.state[1] == pytest.approx(alone.state[0], abs=1e-7)  # the root of the rounding of the cost
    assert found.converged


def test_plain_gauss_newton_stops_where_a_full_step_raises_the_cost_and_keeps_the_better_point():
    problem = Problem(lambda p: np.arctan(p) + 0 * p, 1)
    near = minimise_dense(problem, np.array([1.0]), DenseMethod(full=True), EXACT)
    assert near.converged
    far = minimise_dense(problem, np.array([3.0]), DenseMethod(full=True), EXACT)
    assert not far.converged
    assert far.reason == "the full step raises the cost"
    assert far.state[0] == 3.0
    assert minimise_dense(problem, np.array([3.0]), DenseMethod(), EXACT).converged


def test_every_turn_is_told_with_cost_damping_gain_and_step():
    turns = []
    found = minimise_dense(Problem(rosenbrock, 2), np.array([-1.2, 1.0]), DenseMethod(), EXACT, turns.append)
    assert [turn.number for turn in turns] == list(range(1, found.iterations + 1))
    assert turns[0].damping == EXACT.damping
    costs = [turn.trial_cost for turn in turns if turn.accepted]
    assert costs == sorted(costs, reverse=True)
    assert all(turn.gain > 0 for turn in turns[:-2] if turn.accepted)  # the last ones are rounding
    assert any(turn.damping > before.damping for before, turn in pairwise(turns))


def test_a_step_into_the_undefined_is_not_taken():
    problem = Problem(lambda p: np.log(p) - np.array([0.0, 0.2]), 1)  # the full step from 30 ends below 0
    found = minimise_dense(problem, np.array([30.0]), DenseMethod(geodesic=False), EXACT)
    assert found.converged
    assert found.state[0] == pytest.approx(np.exp(0.1), rel=1e-7)


def test_the_start_must_be_defined():
    problem = Problem(np.log, 1)
    equations = linearise_dense(problem, np.array([-1.0]))
    assert equations.cost == np.inf
