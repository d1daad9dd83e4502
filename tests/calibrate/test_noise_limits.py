"""Where corners and views stop counting, and what is said of those that do: one example on each side."""

import numpy as np
import pytest
from scipy.stats import chi2

from camcal.calibrate.noise import (
    CUT,
    REJECTED,
    ViewNoise,
    corner_weights,
    lost,
    median_limit,
    robust_sigma,
    truncation,
    view_noise,
)

RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))
CORNERS = 40


def noise_of(*variances, sigma=1.0):
    return ViewNoise(sigma, np.array(variances))


@pytest.mark.parametrize(("deviations", "rejected"), [(4.45, False), (4.55, True)])
def test_a_corner_is_rejected_beyond_four_and_a_half_standard_deviations(deviations, rejected):
    found = corner_weights(
        np.full((1, CORNERS), 0.2 * deviations), np.ones((1, CORNERS), bool), noise_of(1, sigma=0.2), 0
    )
    assert (found < REJECTED).all() == rejected


@pytest.mark.parametrize(("factor", "rejected"), [(0.99, False), (1.01, True)])
def test_all_corners_of_a_view_are_rejected_beyond_the_limit_of_their_median(factor, rejected):
    median = factor * median_limit(noise_of(1.0, sigma=0.3))
    variance = (median / RAYLEIGH_MEDIAN / 0.3) ** 2  # the noise of a view whose residuals have that median
    found = corner_weights(np.zeros((1, 2)), np.ones((1, 2), bool), noise_of(variance, sigma=0.3), np.zeros(1))
    assert (found < REJECTED).all() == rejected


def test_a_view_is_lost_that_has_less_than_half_of_the_weight_of_its_corners():
    present = np.ones((4, CORNERS), bool)
    present[2:, 10:] = False
    weights = present * np.array([0.49, 0.51, 0.49, 0.51])[:, None]
    np.testing.assert_array_equal(lost(weights, present), [True, False, True, False])


def test_the_noise_of_a_lost_view_is_that_of_all_its_corners_by_their_median():
    rng = np.random.default_rng(1)
    distances = np.linalg.norm(rng.normal(size=(3, CORNERS, 2)), axis=2)
    distances[1] *= 30.0
    present, weights = np.ones((3, CORNERS), bool), np.ones((3, CORNERS))
    weights[1, 10:] = 0.0
    distances[1, :10] = 1.0  # those that still count say nothing of it
    found = view_noise(distances, present, weights, np.full(3, 6.0), noise_of(1.0, 1.0, 1.0))
    std = np.sort(distances[1])[(CORNERS - 1) // 2] / RAYLEIGH_MEDIAN
    assert found.views[1] == pytest.approx((std / found.sigma) ** 2, rel=1e-9)
    assert found.views[1] > 400
    assert found.views[[0, 2]].max() < 2


def test_a_view_without_corners_does_no_harm():
    present = np.array([[True] * 4, [False] * 4])
    found = corner_weights(np.ones((2, 4)), present, noise_of(1.0, 1.0), np.full(2, 6.0))
    assert (found[0] > 0).all()
    assert (found[1] == 0).all()


@pytest.mark.parametrize("cut", [1.0, 2.0, CUT])
def test_what_a_cut_leaves_of_the_variance_is_that_of_normal_coordinates(cut):
    """The mean of s = d² with s below the cut, over 2: of the density s e^(-s/2) / 4 that of χ² with four degrees."""
    assert truncation(cut) == pytest.approx(chi2.cdf(cut**2, 4) / chi2.cdf(cut**2, 2), rel=1e-12)


def test_the_noise_by_medians_is_a_thousandth_of_a_pixel_at_least():
    found = [robust_sigma(np.full((1, 5), px), np.ones((1, 5), bool)) for px in (0.0, 1.1e-3, 2.5e-3)]
    np.testing.assert_allclose(found, [1e-3, 1e-3, 2.5e-3 / np.sqrt(2 * np.log(2))])


def test_a_cut_of_medians_loses_four_of_a_hundred_thousand_clean_corners():
    assert 1e5 * chi2.sf(CUT**2, 2) == pytest.approx(4, abs=0.5)
