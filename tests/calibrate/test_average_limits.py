"""Weights of estimates at their limits: estimates that no view moves, that are nearly the same, and units."""

import numpy as np

from camcal.calibrate.averaging import weights_of

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
