"""The scale of a class of coefficients: against densities of scipy and integrals over spike and slab on a fine grid."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import multivariate_normal

from camcal.calibrate.shape import scale_of

MEDIAN, SPREAD = 2e-3, 1.2


def positive(rng, count, typical):
    """An information matrix whose coefficients are known to about `typical`, some 30 times better than others."""
    turn = np.linalg.qr(rng.normal(size=(count, count)))[0]
    return turn @ np.diag(typical**-2 * np.exp(rng.uniform(-3.5, 3.5, count))) @ turn.T


def log_density(information, vector, scale):
    """The density of the data's own value Λ⁻¹ g, whose covariance is that of the data and that of the effect."""
    covariance = np.linalg.inv(information)
    value = covariance @ vector
    return multivariate_normal.logpdf(value, cov=covariance + scale**2 * np.eye(len(vector)), allow_singular=False)


def shrunk(information, vector, scale):
    return np.linalg.solve(information + scale**-2 * np.eye(len(vector)), vector)


def brute_force(information, vector, median=MEDIAN, spread=SPREAD):
    """Return probability, mean, standard deviation and effective scale by a sum over 4001 scales."""
    within = np.linspace(-7, 7, 4001)
    scales = median * np.exp(spread * within)
    nothing = log_density(information, vector, 0.0)
    ratio = np.exp([log_density(information, vector, scale) - nothing for scale in scales])
    slab = ratio * np.exp(-0.5 * within**2) / np.sqrt(2 * np.pi) * (within[1] - within[0])
    share = slab / (slab.sum() + 1)
    mean = share @ scales
    average = sum(own * shrunk(information, vector, scale) for own, scale in zip(share, scales, strict=True))

    def excess(log_scale):
        one = shrunk(information, vector, np.exp(log_scale))
        return one @ information @ one - average @ information @ average

    effective = np.exp(brentq(excess, np.log(median) - 14, np.log(median) + 6))
    return share.sum(), mean, np.sqrt(share @ scales**2 - mean**2), effective


@pytest.mark.parametrize("scale", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("count", [1, 3])
def test_the_odds_of_a_known_scale_are_the_ratio_of_two_normal_densities(count, scale):
    rng = np.random.default_rng(1)
    information = positive(rng, count, 5 * MEDIAN)
    vector = information @ (scale * MEDIAN * rng.normal(size=count))
    found = scale_of(information, vector, scale * MEDIAN, 1e-9)  # the slab is next to a second spike
    expected = log_density(information, vector, scale * MEDIAN) - log_density(information, vector, 0.0)
    assert np.log(found.present / (1 - found.present)) == pytest.approx(expected, abs=1e-6)  # rounding
    assert found.mean == pytest.approx(found.present * scale * MEDIAN, rel=1e-6)


@pytest.mark.parametrize("size", [0.0003, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("count", [1, 4])
def test_the_scale_is_that_of_an_integral_over_spike_and_slab(count, size):
    rng = np.random.default_rng(2)
    information = positive(rng, count, 0.7 * MEDIAN)
    vector = information @ (size * MEDIAN * rng.normal(size=count))
    found = scale_of(information, vector, MEDIAN, SPREAD)
    present, mean, std, effective = brute_force(information, vector)
    # the grid ends at four standard deviations: 6e-5 of the slab, more of a mean of squares far above the median
    assert found.present == pytest.approx(present, rel=1e-3)
    assert found.mean == pytest.approx(mean, rel=3e-3)
    assert found.std == pytest.approx(std, rel=1e-2)
    assert found.effective == pytest.approx(effective, rel=3e-3)  # interpolated between scales 5 % apart


def test_one_coefficient_shrinks_under_the_effective_scale_to_its_average_over_spike_and_slab():
    for value in (0.5, 2.0, 4.0):
        information, vector = np.array([MEDIAN**-2]), np.array([value / MEDIAN])
        found = scale_of(information, vector, MEDIAN, SPREAD)
        within = np.linspace(-6, 6, 2001)
        scales = np.append(MEDIAN * np.exp(SPREAD * within), 0.0)
        prior = np.append(np.exp(-0.5 * within**2) / np.exp(-0.5 * within**2).sum(), 1.0)
        variances = MEDIAN**2 + scales**2
        posterior = prior * np.exp(-0.5 * (value * MEDIAN) ** 2 / variances) / np.sqrt(variances)
        average = posterior @ (scales**2 / variances) / posterior.sum()
        kept = found.effective**2 / (found.effective**2 + MEDIAN**2)
        assert kept == pytest.approx(average, rel=2e-3)  # interpolated between scales 5 % apart


def test_a_diagonal_information_may_be_given_as_a_matrix_in_any_axes():
    rng = np.random.default_rng(3)
    values, vector = MEDIAN**-2 * rng.uniform(0.1, 10, 5), rng.normal(size=5) / MEDIAN
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    plain = scale_of(values, vector, MEDIAN, SPREAD)
    for matrix, right in ((np.diag(values), vector), (turn @ np.diag(values) @ turn.T, turn @ vector)):
        found = scale_of(matrix, right, MEDIAN, SPREAD)
        for name in ("effective", "mean", "std", "present"):
            assert getattr(found, name) == pytest.approx(getattr(plain, name), rel=1e-9)  # rounding


def test_the_scale_follows_the_data_without_a_leap():
    rng = np.random.default_rng(4)
    information = positive(rng, 3, 0.3 * MEDIAN)
    direction = information @ (MEDIAN * rng.normal(size=3))
    sizes = np.exp(np.linspace(np.log(0.01), np.log(10), 2001))
    found = [scale_of(information, size * direction, MEDIAN, SPREAD) for size in sizes]
    effective = np.log([one.effective for one in found])
    assert effective[-1] - effective[0] > 4
    # from nothing to nearly all the scale may grow as the fifth power of the data: sizes are 0.35 % apart
    assert np.abs(np.diff(effective)).max() < 8 * np.diff(np.log(sizes))[0]
    assert (np.diff([one.present for one in found]) > -1e-12).all()


def test_many_coefficients_tell_their_scale():
    rng = np.random.default_rng(5)
    for true in (0.3 * MEDIAN, 4 * MEDIAN):
        information = (0.2 * true) ** -2 * rng.uniform(0.5, 2, 400)
        value = true * rng.normal(size=400) + rng.normal(size=400) / np.sqrt(information)
        found = scale_of(information, information * value, MEDIAN, SPREAD)
        assert found.present == pytest.approx(1.0, abs=1e-12)
        assert found.effective == pytest.approx(true, rel=0.12)  # 400 squares: 4 %; scales are 15 % apart
        assert found.mean == pytest.approx(true, rel=0.12)


def test_where_there_is_nothing_the_scale_is_a_small_part_of_the_noise():
    rng = np.random.default_rng(6)
    noise = 0.05 * MEDIAN
    information = np.full(50, noise**-2)
    found = scale_of(information, rng.normal(size=50) / noise, MEDIAN, SPREAD)
    assert found.present < 0.01
    assert found.effective < 0.1 * noise
    assert found.mean < 0.01 * noise


def test_without_information_the_scale_is_that_of_the_prior():
    found = scale_of(np.full(3, 1e-12), np.full(3, 1e-9), MEDIAN, SPREAD)
    assert found.present == pytest.approx(0.5, abs=1e-6)
    assert found.mean == pytest.approx(0.5 * MEDIAN * np.exp(SPREAD**2 / 2), rel=4e-3)  # up to four deviations
    square = 0.5 * MEDIAN**2 * np.exp(2 * SPREAD**2)
    assert found.mean**2 + found.std**2 == pytest.approx(square, rel=0.07)  # of which 5 % lie beyond four deviations


@pytest.mark.parametrize("unit", [1e3, 1e9])
def test_units_do_not_matter(unit):
    rng = np.random.default_rng(7)
    information = positive(rng, 4, MEDIAN)
    vector = information @ (2 * MEDIAN * rng.normal(size=4))
    one = scale_of(information, vector, MEDIAN, SPREAD)
    other = scale_of(information / unit**2, vector / unit, unit * MEDIAN, SPREAD)
    for name, factor in (("effective", unit), ("mean", unit), ("std", unit), ("present", 1.0)):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name), rel=1e-9)


def test_the_sign_of_the_data_does_not_matter():
    information, vector = positive(np.random.default_rng(8), 3, MEDIAN), np.array([1.0, -2.0, 3.0]) / MEDIAN
    assert scale_of(information, vector, MEDIAN, SPREAD) == scale_of(information, -vector, MEDIAN, SPREAD)


@pytest.mark.parametrize("vector", [np.zeros(3), np.full(3, 1e-200)])
def test_data_of_exactly_nothing_give_the_scale_of_data_that_are_nearly_nothing(vector):
    information = np.full(3, (0.1 * MEDIAN) ** -2)
    found = scale_of(information, vector, MEDIAN, SPREAD)
    nearly = scale_of(information, np.full(3, 1e-6 / MEDIAN), MEDIAN, SPREAD)
    assert found.effective == pytest.approx(nearly.effective, rel=0.01)
