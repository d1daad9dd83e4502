"""How far the scatter from view to view counts in the covariance, where errors within views are not seen."""

from types import SimpleNamespace

import numpy as np
import pytest

from camcal.calibrate.jackknife import covariance_of
from camcal.calibrate.problem import BoardProblem, State

LENS = 2
CLAIMED = np.diag([1.0, 2.0])


def covariance(views, believed):
    """Return the covariance by views whose scatter is ten times what is claimed, and that believed in full."""
    problem = BoardProblem(None, None, None, np.arange(LENS))
    state = State(np.zeros(LENS), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    estimates = [SimpleNamespace(problem=problem, state=state, posterior=SimpleNamespace(shared=CLAIMED))]
    moved = [10 * np.random.default_rng(views).normal(size=(views, LENS))]
    return [covariance_of(estimates, moved, np.eye(LENS), np.ones(1), share) for share in (believed, 1.0)]


def test_many_views_that_do_not_show_errors_leave_what_is_claimed():
    found, full = covariance(700, 0.0)
    np.testing.assert_allclose(found, CLAIMED, atol=2e-4 * np.abs(full).max())  # (7 / 700)² of the scatter
    assert np.trace(full) > 100 * np.trace(CLAIMED)


@pytest.mark.parametrize("views", [3, 5, 7])
def test_few_views_would_not_show_them_and_are_doubted_in_full(views):
    found, full = covariance(views, 0.0)
    np.testing.assert_allclose(found, full, rtol=1e-12)


@pytest.mark.parametrize(("views", "believed", "doubted"), [(14, 0.0, 0.25), (14, 0.4, 0.55), (70, 0.5, 0.505)])
def test_between_both_the_covariances_are_mixed(views, believed, doubted):
    found, full = covariance(views, believed)
    np.testing.assert_allclose(found, doubted * full + (1 - doubted) * CLAIMED, rtol=1e-12)
