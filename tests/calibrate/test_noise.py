"""The noise of corners, of views and of all of them: against what was drawn, and against integrals over a Gaussian."""

import numpy as np
import pytest
from scipy.integrate import quad

from camcal.calibrate import noise
from camcal.calibrate.noise import ViewNoise, clipped, corner_weights, count_of, first_noise, view_noise

RAYLEIGH_MEDIAN = np.sqrt(2 * np.log(2))  # of the length of a residual whose coordinates are standard normal


def gaussian(weight):
    """The mean of a function of d² over residuals of two standard normal coordinates: d² / 2 is exponential."""
    return quad(lambda length: weight(length**2) * length * np.exp(-(length**2) / 2), 0, 40)[0]


def weight(squared):
    return 1 / (1 + (squared / 16) ** 3)


MEAN_WEIGHT = gaussian(weight)
MEAN_SQUARE = gaussian(lambda squared: weight(squared) * squared) / 2  # of a coordinate, by its corner's weight


def lengths(rng, shape, sigma=1.0):
    return sigma * np.linalg.norm(rng.normal(size=(*shape, 2)), axis=-1)


def alternated(distances, present, spent, start, rounds=40):
    """The noise and weights at which both have settled."""
    found = start
    for _ in range(rounds):
        weights = corner_weights(distances, present, found, spent)
        found = view_noise(distances, present, weights, spent, found)
    return found, corner_weights(distances, present, found, spent)


def test_the_first_noise_is_the_median_of_all_views_medians():
    rng = np.random.default_rng(1)
    sigmas = np.array([0.2, 0.2, 0.2, 1.0, 0.05])
    found = first_noise(lengths(rng, (5, 2001)) * sigmas[:, None], np.ones((5, 2001), bool))
    assert found.sigma == pytest.approx(0.2, rel=0.04)  # a median of 2001: 1.6 %
    assert found.views[3] == pytest.approx(25, rel=0.1)
    assert found.views[4] == 1.0  # a finer view is no reason for trust


def test_the_first_noise_of_four_residuals_is_that_of_the_second_largest_but_one():
    distances = np.array([[4.0, 1.0, 3.0, 2.0, 9.0]])
    present = np.array([[True, True, True, True, False]])
    assert first_noise(distances, present).sigma == pytest.approx(2.0 / RAYLEIGH_MEDIAN, rel=1e-12)


@pytest.mark.parametrize("share", [0.1, 0.4])
def test_the_first_noise_of_a_view_bears_gross_errors_of_nearly_half_its_corners(share):
    rng = np.random.default_rng(2)
    distances = lengths(rng, (9, 500), 0.3)
    wrong = np.arange(500) < share * 500
    distances[4, wrong] = 500.0
    distances[5, wrong] = np.nan
    found = first_noise(distances, np.ones((9, 500), bool))
    assert found.sigma == pytest.approx(0.3, rel=0.05)  # a median of nine medians, each to 4 %
    # the median is then the quantile ½ / (1 - share) of a Rayleigh distribution
    shifted = np.sqrt(-2 * np.log(1 - 0.5 / (1 - share))) / RAYLEIGH_MEDIAN
    for view in (4, 5):
        assert np.sqrt(found.views[view]) == pytest.approx(max(shifted, 1.0), rel=0.1)
    weights = corner_weights(distances, np.ones((9, 500), bool), found, np.zeros(9))
    assert weights[4:6, wrong].max() < 0.01
    assert weights[4:6, ~wrong].mean() > 0.95


def test_the_first_noise_of_corners_that_are_not_there_and_of_perfect_ones_is_finite():
    present = np.array([[True, True, True], [False, False, False], [True, False, False]])
    found = first_noise(np.zeros((3, 3)), present)
    assert found.sigma == 1e-4
    assert np.isfinite(found.views).all()
    assert (found.views >= 1).all()
    assert found.views.max() == 1e6  # a view of no corner counts as a thousand times as noisy


def test_a_corner_has_half_its_weight_at_four_standard_deviations_of_what_parameters_left_of_it():
    noise_of_all = ViewNoise(0.2, np.array([1.0, 9.0, 1.0]))
    spent = np.array([0.0, 0.0, 5.0])  # of the 20 coordinates of ten corners
    std = 0.2 * np.array([1.0, 3.0, np.sqrt(0.75)])
    for multiple, expected in ((0.0, 1.0), (2.0, 64 / 65), (4.0, 0.5), (8.0, 1 / 65)):
        distances = np.tile(multiple * std[:, None], (1, 10))
        weights = corner_weights(distances, np.ones((3, 10), bool), noise_of_all, spent)
        expected_of_view = expected / (1 + (np.array([1.0, 9.0, 1.0]) / 256) ** 3)
        np.testing.assert_allclose(weights, np.tile(expected_of_view[:, None], (1, 10)), rtol=1e-12)


def test_a_view_has_half_its_weight_at_sixteen_times_the_noise():
    found = corner_weights(
        np.zeros((3, 2)), np.ones((3, 2), bool), ViewNoise(1.0, np.array([1, 256.0, 1e6])), np.zeros(3)
    )
    np.testing.assert_allclose(found[:, 0], [1.0, 0.5, 0.0], atol=1e-7)


def test_a_corner_without_an_image_far_away_or_not_there_has_no_weight():
    distances = np.array([[np.nan, 999.0, 1001.0, 0.0, 0.0]])
    present = np.array([[True, True, True, False, True]])
    weights = corner_weights(distances, present, ViewNoise(1.0, np.ones(1)), np.zeros(1))[0]
    np.testing.assert_array_equal(weights == 0, [True, False, True, True, False])


def test_parameters_may_not_take_all_of_a_corner():
    distances = np.full((2, 4), 4 * np.sqrt(0.05))
    weights = corner_weights(distances, np.ones((2, 4), bool), ViewNoise(1.0, np.ones(2)), np.array([8.0, 7.99]))
    np.testing.assert_allclose(weights, 0.5, rtol=1e-6)  # beside the view's own weight, 1 - 6e-8


def test_coordinates_are_counted_in_full_where_corners_are_gaussian():
    rng = np.random.default_rng(3)
    distances = lengths(rng, (4, 50_000))
    weights = corner_weights(distances, np.ones(distances.shape, bool), ViewNoise(1.0, np.ones(4)), np.zeros(4))
    assert weights.mean() == pytest.approx(MEAN_WEIGHT, rel=1e-3)
    np.testing.assert_allclose(count_of(weights), 100_000, rtol=2e-3)  # weights spread by some 5 %
    np.testing.assert_allclose(count_of(np.array([[0.5, 0.5], [0.0, 0.0]])), [2.0202, 0.0], rtol=1e-3)


def test_the_constants_are_means_over_a_gaussian():
    assert pytest.approx(MEAN_WEIGHT, rel=1e-6) == noise._MEAN_WEIGHT
    assert pytest.approx(MEAN_SQUARE, rel=1e-6) == noise._WEIGHTED_SQUARES


@pytest.mark.parametrize("start", [0.1, 1.0])
def test_the_noise_of_gaussian_residuals_is_found_to_two_percent(start):
    rng = np.random.default_rng(4)
    distances = lengths(rng, (20, 3000), 0.3)
    found, _ = alternated(distances, np.ones(distances.shape, bool), np.zeros(20), ViewNoise(start, np.ones(20)))
    assert found.sigma == pytest.approx(0.3, rel=0.02)  # 120 000 squares: 0.2 %
    np.testing.assert_allclose(found.views, 1.0, atol=0.1)  # 6000 squares: 1.8 %


@pytest.mark.slow
def test_the_noise_of_gaussian_residuals_has_no_bias():
    rng = np.random.default_rng(4)
    distances = lengths(rng, (20, 20_000), 0.3)
    distances *= 0.3 / np.sqrt(np.mean(distances**2) / 2)
    found, _ = alternated(distances, np.ones(distances.shape, bool), np.zeros(20), ViewNoise(0.3, np.ones(20)))
    assert found.sigma == pytest.approx(0.3, rel=1e-3)  # of given mean square, the tail of 400 000 is the Gaussian's


def test_degrees_of_freedom_that_parameters_have_spent_do_not_count():
    rng = np.random.default_rng(5)
    basis = np.linalg.qr(rng.normal(size=(400, 60)))[0]
    residuals = rng.normal(size=(40, 400))
    residuals -= residuals @ basis @ basis.T  # 60 of 400 coordinates of each view
    distances = np.linalg.norm(residuals.reshape(40, 200, 2), axis=2)
    present, start = np.ones((40, 200), bool), ViewNoise(0.8, np.ones(40))
    found, weights = alternated(distances, present, np.full(40, 60.0), start)
    assert found.sigma == pytest.approx(1.0, rel=0.015)  # 13 600 squares: 0.6 %
    naive, _ = alternated(distances, present, np.zeros(40), start)
    assert naive.sigma == pytest.approx(np.sqrt(0.85), rel=0.015)
    assert weights.mean() == pytest.approx(MEAN_WEIGHT, rel=2e-3)  # what parameters left is judged as if in full


def test_a_view_of_five_times_the_noise_is_told_from_the_others():
    rng = np.random.default_rng(6)
    distances, spent = lengths(rng, (10, 400), 0.1), np.full(10, 6.0)
    distances[3] *= 5
    found, weights = alternated(distances, np.ones(distances.shape, bool), spent, ViewNoise(0.1, np.ones(10)))
    variances = 0.01 * np.where(np.arange(10) == 3, 25, 1)
    np.testing.assert_allclose(found.sigma**2 * found.views, variances, rtol=0.15)  # 800 squares: 5 %
    # the prior of 20 degrees of freedom about one has views so that the mean of their 1 / variance is one
    assert np.mean(1 / found.views) == pytest.approx(1.0, rel=1e-3)
    assert weights[3].mean() == pytest.approx(weights[0].mean(), rel=0.01)  # a corner is judged by its own view


def test_a_view_of_few_corners_stays_near_the_others():
    rng = np.random.default_rng(7)
    distances, present = lengths(rng, (30, 400)), np.ones((30, 400), bool)
    present[0, 10:] = False
    distances[0] = np.sqrt(2 * 9.0)  # ten corners, 20 coordinates of variance 9, six of which are spent
    start = ViewNoise(1.0, np.ones(30))
    weights = np.where(present, 1.0, 0.0)
    spent = np.full(30, 6.0)
    found = start
    for _ in range(40):
        found = view_noise(distances, present, weights, spent, found)
    # full weights stand for more than ten Gaussian corners, whose weights and squares would be a little less
    own = 20 * 9 / MEAN_SQUARE / found.sigma**2
    assert found.views[0] == pytest.approx((20 + own) / (20 + 20 / MEAN_WEIGHT - 6), rel=1e-6)


def test_new_noise_goes_a_share_of_the_way_in_logarithms():
    rng = np.random.default_rng(8)
    distances, present = lengths(rng, (6, 30), 0.4), np.ones((6, 30), bool)
    distances[2] *= 3
    weights, spent = np.ones((6, 30)), np.full(6, 6.0)
    start = ViewNoise(0.1, np.linspace(0.5, 3, 6))
    once = view_noise(distances, present, weights, spent, start, 0.3)
    end = start
    for _ in range(60):
        end = view_noise(distances, present, weights, spent, end)
    # weights are held: the end does not depend on the start, 30 alternations leave 1e-4 of the way
    assert once.sigma == pytest.approx(start.sigma**0.7 * end.sigma**0.3, rel=5e-3)
    np.testing.assert_allclose(once.views, start.views**0.7 * end.views**0.3, rtol=1e-2)


def test_held_weights_end_where_noise_and_views_answer_each_other():
    rng = np.random.default_rng(9)
    distances, present = lengths(rng, (6, 30), 0.4), np.ones((6, 30), bool)
    distances[2] *= 4
    distances[4] *= 40
    weights, spent = rng.uniform(0.3, 1, (6, 30)), np.linspace(4, 9, 6)
    end = ViewNoise(0.3, np.ones(6))
    for _ in range(80):
        end = view_noise(distances, present, weights, spent, end)
    squares = np.sum(weights * distances**2, axis=1) / MEAN_SQUARE
    dof = 2 * np.sum(weights, axis=1) / MEAN_WEIGHT - spent
    trust = 1 / (1 + (end.views / 256) ** 3)
    assert trust[4] < 0.5 < trust[2]
    assert end.sigma**2 == pytest.approx(np.sum(trust * squares / end.views) / np.sum(trust * dof), rel=1e-6)
    np.testing.assert_allclose(end.views, (20 + squares / end.sigma**2) / (20 + dof), rtol=1e-6)


def test_parameters_may_not_take_all_degrees_of_freedom_of_a_view():
    distances, present = np.full((3, 10), np.sqrt(2.0)), np.ones((3, 10), bool)
    found = ViewNoise(1.0, np.ones(3))
    for _ in range(80):
        found = view_noise(distances, present, np.ones((3, 10)), np.array([0.0, 0.0, 30.0]), found)
    expected = (20 + 20 / MEAN_SQUARE / found.sigma**2) / (20 + 0.05 * 20 / MEAN_WEIGHT)
    assert found.views[2] == pytest.approx(expected, rel=1e-6)


def test_corners_whose_image_was_lost_count_for_nothing():
    rng = np.random.default_rng(10)
    distances, present = lengths(rng, (4, 200)), np.ones((4, 200), bool)
    weights, spent, start = np.ones((4, 200)), np.full(4, 6.0), ViewNoise(0.9, np.ones(4))
    weights[:, :20] = 0
    zero = view_noise(distances, present, weights, spent, start)
    weights[:, :20] = 1
    distances[:, :20] = np.nan
    lost = view_noise(distances, present, weights, spent, start)
    assert lost.sigma == pytest.approx(zero.sigma, rel=1e-12)
    np.testing.assert_allclose(lost.views, zero.views, rtol=1e-12)


def test_the_noise_does_not_fall_far_below_the_median_of_all_corners():
    rng = np.random.default_rng(11)
    distances, present = lengths(rng, (5, 400)), np.ones((5, 400), bool)
    weights = np.where(distances < 0.2, 1.0, 0.0)  # as if only the best had been kept
    found = ViewNoise(0.9, np.ones(5))
    for _ in range(60):
        found = view_noise(distances, present, weights, np.zeros(5), ViewNoise(found.sigma, np.ones(5)))
    expected = 0.8 * np.median(distances) / RAYLEIGH_MEDIAN
    assert found.sigma == pytest.approx(expected, rel=1e-9)
    assert found.sigma == pytest.approx(0.8, rel=0.05)


def test_the_bound_by_the_median_takes_the_noise_of_views_out():
    rng = np.random.default_rng(12)
    distances, present = lengths(rng, (6, 400)), np.ones((6, 400), bool)
    views = np.array([1.0, 1.0, 25.0, 25.0, 25.0, 25.0])
    distances *= np.sqrt(views)[:, None]
    weights = np.where(distances < 0.2 * np.sqrt(views)[:, None], 1.0, 0.0)
    found = ViewNoise(0.9, views)
    for _ in range(60):
        found = view_noise(distances, present, weights, np.zeros(6), ViewNoise(found.sigma, views))
    expected = 0.8 * np.median(distances / np.sqrt(views)[:, None]) / RAYLEIGH_MEDIAN
    assert found.sigma == pytest.approx(expected, rel=1e-9)


def test_perfect_corners_have_the_finest_noise():
    found = ViewNoise(1.0, np.ones(3))
    for _ in range(60):
        found = view_noise(np.zeros((3, 20)), np.ones((3, 20), bool), np.ones((3, 20)), np.full(3, 6.0), found)
    assert found.sigma == pytest.approx(1e-4, rel=1e-9)


def test_units_do_not_matter():
    rng = np.random.default_rng(13)
    distances, present = lengths(rng, (6, 100)), np.ones((6, 100), bool)
    distances[0] *= 3
    weights, spent, start = rng.uniform(0.5, 1, (6, 100)), np.full(6, 8.0), ViewNoise(0.7, np.linspace(1, 2, 6))
    found = view_noise(distances, present, weights, spent, start)
    larger = view_noise(50 * distances, present, weights, spent, ViewNoise(35.0, start.views))
    assert larger.sigma == pytest.approx(50 * found.sigma, rel=1e-9)
    np.testing.assert_allclose(larger.views, found.views, rtol=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.2])
def test_gross_errors_change_the_noise_little(share):
    rng = np.random.default_rng(14)
    distances, present = lengths(rng, (20, 1000), 0.1), np.ones((20, 1000), bool)
    wrong = rng.random(distances.shape) < share
    distances[wrong] = rng.uniform(1, 50, wrong.sum())  # from ten standard deviations
    found, weights = alternated(distances, present, np.full(20, 6.0), first_noise(distances, present))
    assert found.sigma * np.sqrt(np.median(found.views)) == pytest.approx(0.1, rel=0.03)  # the tail beyond four
    assert weights[wrong].max(initial=0) < 0.02
    assert weights[~wrong].mean() > 0.98


def test_residuals_are_cut_to_four_standard_deviations_in_their_direction():
    rng = np.random.default_rng(15)
    residuals = 0.3 * rng.normal(size=(4001, 2))
    residuals[:3] = [[30.0, 0.0], [-3.0, 4.0], [0.0, 0.0]]
    found = clipped(residuals)
    longest = 4 * np.median(np.hypot(*residuals.T)) / RAYLEIGH_MEDIAN
    assert longest == pytest.approx(1.2, rel=0.04)
    np.testing.assert_allclose(found[:3], [[longest, 0.0], [-0.6 * longest, 0.8 * longest], [0.0, 0.0]], rtol=1e-12)
    short = np.hypot(*residuals.T) <= longest
    assert np.sum(~short) < 8  # 3 of 10 000 Gaussian ones
    np.testing.assert_array_equal(found[short], residuals[short])
    assert clipped(np.zeros((0, 2))).shape == (0, 2)
    np.testing.assert_array_equal(clipped(np.zeros((3, 2))), np.zeros((3, 2)))
