"""Robust losses: weights are the slopes of costs, small residuals count in full, and large ones do not."""

import numpy as np
import pytest
from scipy.special import gammaincc

from camcal.solve.differentiate import central_jacobian
from camcal.solve.losses import Cauchy, Huber, SoftL1, Tukey, chi_square_beyond

LOSSES = [Huber(1.5), Cauchy(1.5), SoftL1(1.5), Tukey(1.5)]
BY_NAME = pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)


@BY_NAME
def test_the_weight_is_the_slope_of_the_cost_by_the_squared_residual(loss):
    for squared in (0.01, 0.5, 2.0, 3.0, 40.0):  # not 2.25, where the slope of Huber's has a corner
        slope = central_jacobian(loss.cost, np.array([squared]), 1e-3 * squared)
        # fourth order, and costs near 1 known to 1e-16 over steps of 1e-5 and more
        np.testing.assert_allclose(slope[0, 0], loss.weight(np.array([squared]))[0], atol=1e-9)


@BY_NAME
def test_small_residuals_count_as_in_least_squares(loss):
    small = np.array([0.0, 1e-6])
    np.testing.assert_allclose(loss.cost(small), small, rtol=1e-6, atol=0)
    np.testing.assert_allclose(loss.weight(small), 1.0, rtol=1e-6)


@BY_NAME
def test_no_loss_grows_faster_than_the_square_and_none_falls(loss):
    squared = np.linspace(0, 100, 1001)
    cost = loss.cost(squared)
    assert np.all(np.diff(cost) >= -1e-15)
    assert np.all(cost <= squared + 1e-12)
    assert np.all(loss.weight(squared) <= 1)


def test_far_residuals_pull_evenly_less_and_less_or_not_at_all():
    far = np.array([1e4, 4e4])  # at 100 and 200, scales of 1.5
    pulls = {type(loss): loss.weight(far) * np.sqrt(far) for loss in LOSSES}
    np.testing.assert_allclose(pulls[Huber], 1.5)
    np.testing.assert_allclose(pulls[SoftL1], 1.5, rtol=2e-4)  # its distance from Huber's at 60 scales
    np.testing.assert_allclose(pulls[Cauchy][0] / pulls[Cauchy][1], 2, rtol=1e-3)
    np.testing.assert_array_equal(pulls[Tukey], 0)


@pytest.mark.parametrize("dof", range(1, 12))
def test_the_tail_of_chi_square_is_that_of_the_incomplete_gamma_function(dof):
    for value in (0.0, 1e-9, 0.3, 1.0, 7.0, 40.0, 300.0):
        np.testing.assert_allclose(chi_square_beyond(value, dof), gammaincc(dof / 2, value / 2), rtol=1e-13)
    assert chi_square_beyond(-1e-12, dof) == 1.0  # gains by rounding
