"""The variances of effects: against the restricted likelihood of a small mixed model, computed with dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from mixed_model import (
    COLUMNS,
    EFFECT,
    ROWS,
    VIEWS,
    columns_of,
    mixed,
    scales,
    slope_and_information,
    unlikeliness,
)
from scipy.optimize import minimize

from camcal.calibrate import effects
from camcal.calibrate.effects import EffectScales, fit_effects, likelihood_gain, posterior, scaled
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian, factorise


@pytest.fixture
def one_round(monkeypatch):
    monkeypatch.setattr(effects, "_ROUNDS", 1)


def test_scales_start_at_a_third_of_the_noise_and_a_ten_thousandth_of_the_board():
    start = EffectScales.start(7, 0.2, 0.5)
    np.testing.assert_allclose(np.sqrt(start.variances), [0.06, 0.06, 5e-5], rtol=1e-12)
    np.testing.assert_array_equal(start.typical, start.variances)
    np.testing.assert_array_equal(start.shares, np.ones((7, 3)))


def test_a_coefficient_has_the_variance_of_its_effect_times_the_share_of_its_view():
    found = EffectScales(np.array([4.0, 9.0, 1.0]), np.array([[1.0, 1.0, 1.0], [0.25, 4.0, 1.0]]), np.ones(3))
    np.testing.assert_allclose(found.std(np.array([0, 1, 1])), [[2, 3, 3], [1, 6, 6]], rtol=1e-12)


def test_equations_in_standard_deviations_are_those_of_scaled_columns_and_a_unit_prior():
    model, std = mixed(), scales().std(EFFECT)
    found, expected = scaled(model.equations(), std), model.equations(by=std, prior=1.0)
    for name in ("cost", "group_group", "group_shared", "shared_shared", "group_gradients", "group_products"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12, err_msg=name)
    np.testing.assert_allclose(found.gradient.groups, expected.gradient.groups, rtol=1e-12)
    np.testing.assert_allclose(found.gradient.shared, expected.gradient.shared, rtol=1e-12)


def test_scaling_leaves_the_equations_it_is_given_as_they_are():
    model = mixed()
    equations, again = model.equations(), model.equations()
    scaled(equations, np.ones((VIEWS, COLUMNS)))
    np.testing.assert_array_equal(equations.group_group, again.group_group)


def dense_covariance(model, std):
    """The inverse of the normal matrix of everything: effects in standard deviations, poses, lens."""
    columns = np.concatenate([model.random() * std.ravel(), model.fixed()], axis=1)
    ridge = np.zeros(columns.shape[1])
    ridge[: VIEWS * COLUMNS] = 1.0
    return np.linalg.inv(columns.T @ (columns / model.noise()[:, None]) + np.diag(ridge))


@pytest.mark.parametrize("shared", [0, 1, 4])
def test_the_posterior_is_part_of_the_inverse_of_the_whole_normal_matrix(shared):
    model, std = mixed(shared=shared), scales().std(EFFECT)
    factors = factorise(scaled(model.equations(), std))
    found, effects = posterior(factors), factors.group_covariances()[:, 6:, 6:]
    covariance = dense_covariance(model, std)
    count = len(covariance)
    np.testing.assert_allclose(
        found.shared, covariance[count - shared :, count - shared :], rtol=1e-8
    )  # of condition 1e4
    for view in range(VIEWS):
        own = slice(view * COLUMNS, (view + 1) * COLUMNS)
        np.testing.assert_allclose(effects[view], covariance[own, own], rtol=1e-8, atol=1e-10)


def test_a_view_has_spent_the_trace_of_its_part_of_the_hat_matrix_where_nothing_is_shared():
    model, std = mixed(shared=0), scales().std(EFFECT)
    found = posterior(factorise(scaled(model.equations(), std))).spent
    np.testing.assert_allclose(found, np.diag(model.hat(std)).reshape(VIEWS, -1).sum(axis=1), rtol=1e-8)


def test_a_view_has_spent_the_trace_of_its_part_of_the_hat_matrix():
    model, std = mixed(), scales().std(EFFECT)
    found = posterior(factorise(scaled(model.equations(), std))).spent
    expected = np.diag(model.hat(std))[: VIEWS * 2 * ROWS].reshape(VIEWS, -1).sum(axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_without_effects_a_view_has_spent_its_pose_and_its_part_of_the_lens():
    model = mixed()
    model = replace(model, effects=model.effects[:, :, :0])
    block = model.blocks()[0]
    prior = model.blocks()[1]
    equations = scaled(assemble([block, prior], 4, VIEWS, 6), np.zeros((VIEWS, 0)))
    columns = model.fixed()
    weighted = columns / model.noise()[:, None]
    hat = np.diag(columns @ np.linalg.solve(columns.T @ weighted, weighted.T))
    expected = hat[: VIEWS * 2 * ROWS].reshape(VIEWS, -1).sum(axis=1)
    np.testing.assert_allclose(posterior(factorise(equations)).spent, expected, rtol=1e-8)


def test_offsets_of_single_points_widen_the_covariance_of_what_all_rows_share():
    rng = np.random.default_rng(8)
    model, std = mixed(), scales().std(EFFECT)
    block, prior = model.blocks()
    points = rng.normal(size=(VIEWS * ROWS, 2, 1))
    which = np.tile(np.arange(ROWS), VIEWS)
    block = replace(block, shared=(*block.shared, Jacobian(points, 4 + which[:, None])))
    holding = Block(np.zeros((ROWS, 1)), (Jacobian(np.full((ROWS, 1, 1), 2.0), 4 + np.arange(ROWS)[:, None]),))
    found = posterior(factorise(scaled(assemble([block, prior, holding], 4 + ROWS, VIEWS, 6 + COLUMNS), std)))
    dense = np.zeros((VIEWS, ROWS, 2, ROWS))
    dense[:, np.arange(ROWS), :, np.arange(ROWS)] = points.reshape(VIEWS, ROWS, 2).transpose(1, 0, 2)
    columns = np.concatenate([model.random() * std.ravel(), model.fixed()], axis=1)
    ridge = np.concatenate([np.ones(VIEWS * COLUMNS), np.zeros(6 * VIEWS + 4), np.full(ROWS, 4.0)])
    columns = np.concatenate([columns, np.concatenate([dense.reshape(-1, ROWS), np.zeros((4, ROWS))])], axis=1)
    covariance = np.linalg.inv(columns.T @ (columns / model.noise()[:, None]) + np.diag(ridge))
    lens = slice(VIEWS * (COLUMNS + 6), VIEWS * (COLUMNS + 6) + 4)
    assert found.shared.shape == (4, 4)
    np.testing.assert_allclose(found.shared, covariance[lens, lens], rtol=1e-8)


@pytest.mark.parametrize("shared", [0, 4])
def test_a_step_follows_the_slope_of_the_restricted_likelihood_and_its_information(one_round, shared):
    model, start = mixed(shared=shared), scales()
    found = fit_effects(model.equations(), columns_of(model).effect, start)
    slope, information = slope_and_information(model, start)
    change = np.linalg.solve(information, slope)
    assert np.abs(change).max() < 2.0  # else it is cut
    assert np.abs(change[:3]).min() > 0.05
    np.testing.assert_allclose(np.log(found.variances / start.variances), change[:3], rtol=1e-5)
    np.testing.assert_allclose(np.log(found.shares / start.shares).ravel(), change[3:], rtol=1e-5, atol=1e-7)


def test_a_step_is_no_longer_than_two_logarithms(one_round):
    model, typical = mixed(), np.full(3, 1e-12)  # of effects that the data say nothing about
    for offset, expected in ((1.0, -1.0), (-1.0, 1.0), (10.0, -2.0), (-10.0, 2.0)):
        start = EffectScales(typical * np.exp(offset), np.ones((VIEWS, 3)), typical)
        change = np.log(fit_effects(model.equations(), columns_of(model).effect, start).variances / start.variances)
        np.testing.assert_allclose(change, expected, rtol=1e-4)  # of a variance of 1e-8 some 1e-6 is known


def test_a_step_that_makes_the_residuals_less_likely_is_cut_short(one_round):
    model = mixed(seed=3)
    for seed in range(8):
        start = scales(seed, spread=3.0)
        found = fit_effects(model.equations(), columns_of(model).effect, start)
        assert unlikeliness(model, found) < unlikeliness(model, start)


def settled(model, start, calls=100):
    """The end of many calls, as of a calibration's passes."""
    for _ in range(calls):
        start = fit_effects(model.equations(), columns_of(model).effect, start)
    return start


def test_the_scales_settle_at_the_maximum_of_restricted_likelihood_and_priors():
    model, start = mixed(seed=3), scales()
    found = settled(model, start)

    def of(values):
        trial = replace(start, variances=np.exp(values[:3]), shares=np.exp(values[3:].reshape(VIEWS, 3)))
        return unlikeliness(model, trial)

    best = minimize(of, np.log([*found.variances, *found.shares.ravel()]), options={"gtol": 1e-4})
    # steps end where the next promises less than 0.001 of a logarithm
    np.testing.assert_allclose(found.variances, np.exp(best.x[:3]), rtol=0.1)
    np.testing.assert_allclose(found.shares.ravel(), np.exp(best.x[3:]), rtol=0.05)
    assert of(np.log([*found.variances, *found.shares.ravel()])) - best.fun < 1e-3


def test_the_gain_is_that_of_the_restricted_likelihood_over_no_effects():
    model = mixed(seed=3)
    start = EffectScales(np.full(3, 0.1), np.ones((VIEWS, 3)), np.full(3, 0.1))
    best = settled(model, start)
    nothing = replace(best, variances=np.full(3, 1e-14))
    expected = model.restricted(best) - model.restricted(nothing)
    assert expected > 20
    assert likelihood_gain(model.equations(), columns_of(model).effect, start) == pytest.approx(expected, abs=0.02)


def test_effects_that_are_not_there_gain_nothing():
    start = EffectScales(np.full(3, 0.1), np.ones((VIEWS, 3)), np.full(3, 0.1))
    gains = [
        likelihood_gain(model.equations(), columns_of(model).effect, start)
        for model in (mixed(seed, sizes=(0, 0, 0)) for seed in range(20))
    ]
    assert max(gains) < 3.0
    assert np.median(gains) < 0.5


def test_the_passes_of_a_calibration_come_near_the_end():
    model = mixed(seed=3)
    start = EffectScales(np.full(3, 0.01), np.ones((VIEWS, 3)), np.full(3, 0.01))
    end = settled(model, start).variances
    # from up to 100 times less
    assert np.abs(np.log(settled(model, start, 4).variances / end)).max() < 0.3
    assert np.abs(np.log(settled(model, start, 10).variances / end)).max() < 0.05


def test_a_view_with_larger_effects_gets_a_larger_share_and_the_others_less():
    model = mixed(seed=4)
    rng = np.random.default_rng(5)
    strong = model.observed.copy()
    strong[2] += model.effects[2][:, EFFECT == 1] @ (5 * rng.normal(size=2))
    start = EffectScales(np.array([0.6, 0.25, 1.4]), np.ones((VIEWS, 3)), np.ones(3))
    found = settled(replace(model, observed=strong), start)
    assert found.shares[2, 1] > 2
    assert np.delete(found.shares[:, 1], 2).max() < found.shares[2, 1] / 2


def test_effects_that_are_not_there_fall_far_below_the_noise_but_not_to_zero():
    model = mixed(seed=6, sizes=(0.0, 1.0, 0.0))
    found = settled(model, EffectScales(np.full(3, 0.1), np.ones((VIEWS, 3)), np.full(3, 0.1)))
    assert (found.variances[[0, 2]] < 0.01).all()
    assert (found.variances > 1e-8).all()
    assert found.variances[1] == pytest.approx(1.0, rel=0.8)  # of ten squares
