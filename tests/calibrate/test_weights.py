"""The error that all corners have in common beyond what their images say."""

import numpy as np
import pytest

from camcal.calibrate.weights import floor_of


def claimed(rng, count):
    shapes = 0.02 * rng.normal(size=(count, 2, 2))
    return shapes @ shapes.swapaxes(1, 2) + 1e-5 * np.eye(2)


@pytest.mark.parametrize("floor", [0.05, 0.2])
def test_it_is_found_among_corners_of_different_covariance(floor):
    rng = np.random.default_rng(2)
    covariances = claimed(rng, 4000)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances + floor**2 * np.eye(2)), rng.normal(size=(4000, 2)))
    assert floor_of(errors, covariances, 1.0) == pytest.approx(floor, rel=0.05)  # 8000 numbers know it to 1 %


def test_there_is_none_where_the_covariances_say_it_all():
    rng = np.random.default_rng(3)
    covariances = claimed(rng, 4000)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(4000, 2)))
    assert floor_of(errors, covariances, 1.0) < 0.002  # a tenth of a typical error


def test_residuals_of_a_fit_are_too_small_and_that_is_allowed_for():
    rng = np.random.default_rng(4)
    covariances = np.tile(1e-6 * np.eye(2), (4000, 1, 1))
    residuals = 0.1 * np.sqrt(0.5) * rng.normal(size=(4000, 2))
    assert floor_of(residuals, covariances, 0.5) == pytest.approx(0.1, rel=0.05)


def test_no_residuals_no_floor():
    assert floor_of(np.zeros((5, 2)), np.tile(np.eye(2), (5, 1, 1)), 1.0) == 0.0
