"""Weights of estimates at their limits: estimates that no view moves, that are nearly the same, that have no priors."""

from types import SimpleNamespace

import numpy as np

from camcal.calibrate.jackknife import covariance_of, weights_of
from camcal.calibrate.problem import BoardProblem, State

VIEWS, LENS = 30, 3


def drawn(seed):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(VIEWS, LENS)), np.eye(LENS)


def test_an_estimate_that_no_view_moves_has_all_of_the_weight():
    moved, metric = drawn(1)
    np.testing.assert_allclose(weights_of([moved, 0 * moved], metric), [0.0, 1.0], atol=1e-6)


def test_weights_of_estimates_that_are_nearly_the_same_differ_little():
    moved, metric = drawn(2)
    other = moved * (1 + 1e-6)
    # the own scatter of each counts once more with ten views, here a third: no ridge is needed to share them
    np.testing.assert_allclose(weights_of([moved, other, moved], metric), np.full(3, 1 / 3), atol=1e-5)


def test_no_prior_and_one_of_infinite_width_leave_the_same_open():
    rng = np.random.default_rng(3)
    moved, claimed = rng.normal(size=(VIEWS, LENS + 1)), np.diag([1.0, 2.0, 3.0, 4.0])
    state = State(rng.normal(size=5), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.ones(1), np.zeros((0, 3)))

    def covariance(**priors):
        problem = BoardProblem(None, None, None, np.array([0, 2, 3]), ("xy",), **priors)
        estimate = SimpleNamespace(problem=problem, state=state, posterior=SimpleNamespace(shared=claimed))
        return covariance_of([estimate], [moved], np.eye(LENS), np.ones(1))

    wide = covariance(lens_spread=np.full(5, np.inf), term_std=np.full(1, np.inf))
    np.testing.assert_allclose(covariance(), wide, rtol=1e-12)
    assert np.trace(covariance(lens_spread=np.full(5, 0.1))) > 2 * np.trace(wide)
