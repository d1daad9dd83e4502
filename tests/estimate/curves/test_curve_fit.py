"""Fits of curves: that errors mean what they say, that outliers do not matter, and what is said when data fail."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit, least_squares

from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.curves.curve import Curve, Data
from camcal.estimate.curves.fit import compare, criteria, fit_curve, likelihood_intervals
from camcal.estimate.curves.search import METHODS, SearchOptions

EXPQUAD = Curve.of("expquad", ["exp(a*x**2 + b*x + c)"], ["a", "b", "c"])
LINE = Curve.of("line", ["m*x + q"], ["m", "q"])
X = np.linspace(0, 1, 100)
PLAIN = SearchOptions(method=METHODS[1])
START = {"a": 2.0, "b": -1.0, "c": 5.0}


def noisy(seed=0, sigma=1.0, x=X):
    truth = np.exp(x**2 + 2 * x + 1)
    return Data({"x": x}, truth + sigma * np.random.default_rng(seed).normal(size=len(x)))


def with_sigma(data, sigma):
    return replace(data, sigma=np.full(len(data), sigma))


def test_values_and_errors_agree_with_scipy():
    data = noisy()
    fit = fit_curve(EXPQUAD, data, START)
    values, covariance = curve_fit(
        lambda x, a, b, c: np.exp(a * x * x + b * x + c), X, data.target, (1, 2, 1), ftol=1e-15, xtol=1e-15
    )
    np.testing.assert_allclose(fit.values, values, rtol=1e-6)  # scipy's forward differences
    np.testing.assert_allclose(fit.covariance, covariance, rtol=1e-5)
    assert fit.goodness.degrees_of_freedom == 97
    assert fit.converged


def test_intervals_cover_the_truth_as_often_as_they_say():
    inside = np.array([covered(noisy(seed, x=X[::10]), PLAIN) for seed in range(100)])
    # 300 answers in 100 groups: a standard error of 0.017 or so about 0.95; normal quantiles would give 0.90
    assert 0.92 <= inside.mean() <= 0.98


def covered(data, options):
    fit = fit_curve(EXPQUAD, data, {"a": 1.0, "b": 2.0, "c": 1.0}, options)
    ends = np.array([estimate.interval for estimate in fit.parameters.values()])
    return (ends[:, 0] <= [1, 2, 1]) & (ends[:, 1] >= [1, 2, 1])


def test_robust_intervals_cover_the_truth_despite_outliers():
    inside = []
    for seed in range(15):
        data = noisy(seed)
        data.target[seed % 10 :: 10] += 15
        inside.append(covered(data, SearchOptions(loss="tukey", method=PLAIN.method)))
    # 45 answers in 15 groups: a standard error of 0.045; those of least squares cover none
    assert np.mean(inside) >= 0.86


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy", "tukey"])
def test_robust_losses_lose_little_without_outliers_and_little_with_them(loss):
    truth, options = np.array([1.0, 2.0, 1.0]), SearchOptions(loss=loss, method=PLAIN.method)
    clean = fit_curve(EXPQUAD, noisy(3), START, options)
    best = fit_curve(EXPQUAD, noisy(3), START)
    std = np.array([estimate.std for estimate in best.parameters.values()])
    assert np.all(np.abs(clean.values - best.values) < 0.7 * std)  # of 95 % efficiency: 0.23 standard errors apart
    spoilt = noisy(3)
    spoilt.target[::9] += 30
    robust = fit_curve(EXPQUAD, spoilt, START, options)
    assert np.all(np.abs(robust.values - truth) < 5 * std)
    assert np.abs(fit_curve(EXPQUAD, spoilt, START).values - truth).max() > 5 * std.max()
    assert robust.goodness.sigma == pytest.approx(1.0, rel=0.35)  # the median of 100 residuals, a ninth spoilt
    assert set(np.flatnonzero(robust.weights < 0.5)) >= set(range(0, 100, 9))


def test_a_loss_that_ignores_outliers_stands_two_fifths_of_them():
    rng = np.random.default_rng(9)
    data = Data({"x": X}, 3 * X + 1 + 0.1 * rng.normal(size=100))
    data.target[rng.permutation(100)[:40]] += rng.uniform(2, 20, 40)
    fit = fit_curve(LINE, data, {"m": 0.0, "q": 0.0}, SearchOptions(loss="tukey"))
    for name, expected in (("m", 3.0), ("q", 1.0)):
        assert abs(fit.parameters[name].value - expected) < 4 * fit.parameters[name].std
    assert np.count_nonzero(fit.weights < 0.01) >= 40
    assert fit.parameters["m"].std < 0.1


def test_robust_fits_with_known_sigma_agree_with_scipy():
    data = with_sigma(noisy(4), 1.0)
    data.target[::9] += 30
    fit = fit_curve(EXPQUAD, data, START, SearchOptions(loss="huber"))
    reference = least_squares(
        lambda p: np.exp(p[0] * X**2 + p[1] * X + p[2]) - data.target, [1, 2, 1], loss="huber", f_scale=1.345,
        xtol=1e-12, ftol=1e-14, gtol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(fit.values, reference.x, atol=1e-4)  # where scipy's cost has settled


def test_with_known_sigma_errors_are_its_own_and_chi_square_is_judged():
    data = with_sigma(noisy(5), 2.0)
    fit = fit_curve(EXPQUAD, data, START)
    doubled = fit_curve(EXPQUAD, noisy(5), START)
    ratio = fit.parameters["a"].std / doubled.parameters["a"].std
    assert ratio == pytest.approx(2.0 / doubled.goodness.sigma)
    assert fit.goodness.chi_square == pytest.approx(doubled.goodness.sum_of_squares / 4)
    assert fit.goodness.p_value > 0.999  # sigma is twice the noise
    low, high = fit.parameters["a"].interval
    assert (high - low) / 2 == pytest.approx(1.959964 * fit.parameters["a"].std, rel=1e-6)


def test_weights_of_unequal_sigmas_make_the_better_data_count():
    rng = np.random.default_rng(6)
    sigma = np.where(X < 0.5, 0.01, 10.0)
    data = Data({"x": X}, 3 * X + 1 + sigma * rng.normal(size=100), sigma)
    fit = fit_curve(LINE, data, {"m": 0.0, "q": 0.0})
    assert fit.values == pytest.approx([3, 1], abs=0.05)
    weights, _ = np.polyfit(X, data.target, 1, w=1 / sigma, cov="unscaled")
    np.testing.assert_allclose(fit.values, weights, rtol=1e-8)


def test_parameters_that_cannot_be_told_apart_are_named_and_the_rest_is_known():
    curve = Curve.of("double", ["d*exp(a*x**2 + b*x + c)"], ["a", "b", "c", "d"])
    fit = fit_curve(curve, noisy(), START | {"d": 2.0})
    (parts,) = fit.combinations
    assert set(parts) == {"c", "d"}
    assert fit.parameters["c"].std is None
    assert fit.parameters["d"].held == "unobservable"
    assert fit.parameters["a"].std == pytest.approx(fit_curve(EXPQUAD, noisy(), START).parameters["a"].std, rel=1e-5)
    assert fit.goodness.degrees_of_freedom == 97  # three combinations were fitted, not four


def test_strong_correlations_are_listed():
    data = Data({"x": X + 50}, 3 * X)
    data.target[::2] += 0.1
    fit = fit_curve(LINE, data, {"m": 0.0, "q": 0.0})
    ((first, second, value),) = fit.strong_correlations()
    assert (first, second) == ("m", "q")
    assert value < -0.99


def test_a_bound_holds_a_parameter_and_it_is_said():
    fit = fit_curve(EXPQUAD, noisy(), START, SearchOptions(bounds={"a": (1.2, 9.0)}))
    assert fit.at_bounds == ("a",)
    assert fit.parameters["a"].value == 1.2
    fixed = fit_curve(EXPQUAD, noisy(), START | {"a": 1.2}, SearchOptions(fixed=frozenset("a")))
    np.testing.assert_allclose(fit.values, fixed.values, rtol=1e-6)
    assert fit.parameters["b"].std == pytest.approx(fixed.parameters["b"].std, rel=1e-5)
    assert fixed.parameters["a"].held == "fixed"


def test_bounds_that_are_not_reached_change_nothing():
    free = fit_curve(EXPQUAD, noisy(), START)
    bounded = fit_curve(EXPQUAD, noisy(), START, SearchOptions(bounds={"a": (-5, 5), "c": (-9, 9)}))
    np.testing.assert_allclose(bounded.values, free.values, rtol=1e-6)
    assert bounded.at_bounds == ()


def test_plain_gauss_newton_finds_the_same_from_near_and_nothing_from_afar():
    near = fit_curve(EXPQUAD, noisy(), START, PLAIN)
    assert near.converged
    np.testing.assert_allclose(near.values, fit_curve(EXPQUAD, noisy(), START).values, rtol=1e-6)
    far = {"a": 0.0, "b": 0.0, "c": 0.0}
    assert not fit_curve(EXPQUAD, noisy(), far, PLAIN).converged
    np.testing.assert_allclose(fit_curve(EXPQUAD, noisy(), far).values, near.values, rtol=1e-6)


def test_restarts_find_what_a_bad_start_misses():
    wave = Curve.of("wave", ["sin(w*x)"], ["w"])
    data = Data({"x": X}, np.sin(10 * X))
    stuck = fit_curve(wave, data, {"w": 16.0})
    found = fit_curve(wave, data, {"w": 16.0}, SearchOptions(restarts=3))
    assert stuck.goodness.rms > 0.5
    assert found.values[0] == pytest.approx(10, abs=1e-9)
    assert found.runs == 4 * stuck.runs


def test_every_turn_of_every_run_is_told():
    turns = []
    fit = fit_curve(EXPQUAD, noisy(), START, observe=lambda run, turn: turns.append((run, turn.number)))
    assert {run for run, _ in turns} == set(range(1, fit.runs + 1))


def test_exact_data_end_at_the_rounding_error():
    data = Data({"x": X}, 3 * X - 2)
    fit = fit_curve(LINE, data, {"m": 50.0, "q": 50.0})
    assert fit.converged
    np.testing.assert_allclose(fit.values, [3, -2], atol=1e-13)
    assert fit.goodness.rms < 1e-14


def test_as_many_data_as_parameters_are_met_but_have_no_errors():
    data = Data({"x": X[:2]}, np.array([1.0, 2.0]))
    fit = fit_curve(LINE, data, {"m": 0.0, "q": 0.0})
    assert fit.goodness.degrees_of_freedom == 0
    assert fit.goodness.sigma is None
    assert fit.parameters["m"].std is None
    assert fit.parameters["m"].held is None


@pytest.mark.parametrize(
    ("data", "start", "options", "error", "words"),
    [
        (
            Data({"x": X[:1]}, X[:1]),
            {"m": 0.0, "q": 0.0},
            SearchOptions(),
            InsufficientData,
            "too few data .1 for 2 param",
        ),
        (Data({"x": X}, X, 0 * X), {"m": 0.0, "q": 0.0}, SearchOptions(), InvalidInput, "sigma must be positive"),
        (Data({"x": X}, X), {"m": 9.0, "q": 0.0}, SearchOptions(bounds={"m": (0, 1)}), InvalidInput, "outside its"),
    ],
)
def test_what_cannot_be_fitted_is_refused(data, start, options, error, words):
    with pytest.raises(error, match=words):
        fit_curve(LINE, data, start, options)


def test_a_start_where_the_curve_is_undefined_is_told_with_the_first_such_row():
    curve = Curve.of("log", ["a*log(x - b)"], ["a", "b"])
    with pytest.raises(InvalidInput, match=r"a=1, b=0.35 the model is not a number for 35 of 100 rows, first for x=0"):
        fit_curve(curve, Data({"x": X}, X), {"a": 1.0, "b": 0.35})


def test_likelihood_intervals_of_a_line_are_those_of_students_t():
    data = Data({"x": X}, 3 * X + np.random.default_rng(1).normal(size=100))
    fit = fit_curve(LINE, data, {"m": 0.0, "q": 0.0})
    for name, ends in likelihood_intervals(fit).items():
        width = np.ptp(fit.parameters[name].interval)
        np.testing.assert_allclose(ends, fit.parameters[name].interval, atol=2e-4 * width)  # read to 1e-4


def test_likelihood_intervals_of_a_curve_are_lopsided_and_open_where_nothing_ends_them():
    x = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 7.0])  # biochemical oxygen demand, Bates & Watts 1988, A1.4
    y = np.array([8.3, 10.3, 19.0, 16.0, 15.6, 19.8])
    curve = Curve.of("bod", ["m*(1 - exp(-k*x))"], ["m", "k"])
    fit = fit_curve(curve, Data({"x": x}, y), {"m": 20.0, "k": 0.5})
    assert fit.values == pytest.approx([19.143, 0.5311], rel=1e-4)  # as published there
    intervals = likelihood_intervals(fit)
    # "the 95 % interval of θ1 is 14.05 to 37.8, of θ2 0.132 to 1.77" (section 6.1.1, from its figure 6.3: to 3 %)
    assert intervals["m"] == pytest.approx((14.05, 37.8), rel=0.03)
    assert intervals["k"] == pytest.approx((0.132, 1.77), rel=0.03)


def test_the_likelihood_of_a_single_parameter_needs_no_other():
    curve = Curve.of("slope", ["m*x"], ["m"])
    data = Data({"x": X}, 3 * X + np.random.default_rng(1).normal(size=100))
    fit = fit_curve(curve, data, {"m": 0.0})
    np.testing.assert_allclose(likelihood_intervals(fit)["m"], fit.parameters["m"].interval, atol=1e-4)


def test_a_likelihood_that_no_value_makes_unlikely_is_open():
    data = Data({"x": X}, 10 * (1 - np.exp(-0.3 * X)) + 0.25 * np.random.default_rng(5).normal(size=100))
    fit = fit_curve(Curve.of("rise", ["m*(1 - exp(-k*x))"], ["m", "k"]), data, {"m": 10.0, "k": 0.3})
    low, high = likelihood_intervals(fit)["m"]
    assert 2 < low < 10
    assert high is None  # data that hardly bend do not say that the rise ever ends


def test_the_better_model_is_preferred_and_the_f_test_agrees():
    data = noisy(7)
    straight = Curve.of("exp", ["exp(b*x + c)"], ["b", "c"])
    larger, smaller = fit_curve(EXPQUAD, data, START), fit_curve(straight, data, {"b": 1.0, "c": 1.0})
    comparison = compare(larger, smaller)
    assert comparison.preferred == "first"
    assert comparison.p_value < 1e-4
    back = compare(smaller, larger)
    assert back.preferred == "second"
    assert back.f == pytest.approx(comparison.f)


def test_a_needless_parameter_is_not_preferred():
    chosen = []
    for seed in range(15):
        data = Data({"x": X}, np.exp(2 * X + 1) + np.random.default_rng(seed).normal(size=100))
        larger = fit_curve(EXPQUAD, data, {"a": 0.0, "b": 2.0, "c": 1.0}, PLAIN)
        smaller = fit_curve(Curve.of("exp", ["exp(b*x + c)"], ["b", "c"]), data, {"b": 2.0, "c": 1.0}, PLAIN)
        comparison = compare(larger, smaller)
        chosen.append(comparison.p_value < 0.05)
        assert comparison.preferred != "first" or comparison.p_value < 0.05
    assert np.mean(chosen) <= 0.2  # 5 % with a standard error of 5.6 %


def test_information_criteria_are_those_of_the_definition():
    fit = fit_curve(LINE, Data({"x": X}, 3 * X + np.random.default_rng(1).normal(size=100)), {"m": 0.0, "q": 0.0})
    found, rss = criteria(fit), fit.goodness.sum_of_squares
    assert found.aic == pytest.approx(100 * np.log(rss / 100) + 2 * 3)
    assert found.bic == pytest.approx(100 * np.log(rss / 100) + 3 * np.log(100))
    assert found.aicc == pytest.approx(found.aic + 2 * 3 * 4 / 96)
