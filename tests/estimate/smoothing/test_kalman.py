"""The steps of the Kalman filter, what its innovations say, and the extended filter."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.estimate.smoothing.kalman import (
    ExtendedModel,
    Gaussian,
    consistency,
    extended_filter,
    extended_smoother,
    gate,
    predict,
    smooth_back,
    successive,
    update,
)
from camcal.solve.differentiate import check_jacobian

F = np.array([[1.0, 0.1], [0.0, 1.0]])
Q = np.array([[0.1**3 / 3, 0.1**2 / 2], [0.1**2 / 2, 0.1]])
H = np.array([[1.0, 0.0]])
R = np.array([[0.04]])


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_an_update_is_the_conditional_of_the_joint_gaussian(rng):
    root = rng.normal(size=(3, 3))
    state = Gaussian(rng.normal(size=3), root @ root.T)
    H = rng.normal(size=(2, 3))
    R = np.diag([0.3, 0.7])
    measured = rng.normal(size=2)
    found = update(state, measured - H @ state.mean, H, R)
    information = np.linalg.inv(state.covariance) + H.T @ np.linalg.inv(R) @ H
    expected = np.linalg.solve(
        information, np.linalg.inv(state.covariance) @ state.mean + H.T @ np.linalg.inv(R) @ measured
    )
    # rounding of 3 × 3 solves
    np.testing.assert_allclose(found.state.mean, expected, atol=1e-10)
    np.testing.assert_allclose(found.state.covariance, np.linalg.inv(information), atol=1e-10)
    S = H @ state.covariance @ H.T + R
    off = measured - H @ state.mean
    assert found.nis == pytest.approx(off @ np.linalg.solve(S, off), rel=1e-9)
    assert found.whitened @ found.whitened == pytest.approx(found.nis, rel=1e-12)
    density = np.exp(-0.5 * found.nis) / np.sqrt(np.linalg.det(2 * np.pi * S))
    assert found.log_likelihood == pytest.approx(np.log(density), rel=1e-9)


def test_covariances_stay_symmetric_and_positive_when_one_measurement_says_nearly_everything():
    state = Gaussian(np.zeros(2), np.diag([1e8, 1e8]))
    for _ in range(200):
        state = predict(update(state, np.zeros(1), H, np.array([[1e-8]])).state, F, 1e-12 * Q)
        np.testing.assert_array_equal(state.covariance, state.covariance.T)
        assert np.linalg.eigvalsh(state.covariance)[0] > 0


def test_a_control_moves_the_mean_and_nothing_else():
    state = Gaussian(np.array([1.0, 2.0]), np.eye(2))
    still, moved = predict(state, F, Q), predict(state, F, Q, np.array([0.5, 0.0]))
    np.testing.assert_allclose(moved.mean - still.mean, [0.5, 0.0], atol=1e-15)
    np.testing.assert_array_equal(moved.covariance, still.covariance)


def test_what_later_measurements_say_never_makes_a_state_less_certain():
    filtered = Gaussian(np.zeros(2), np.diag([0.1, 1.0]))
    ahead = predict(filtered, F, Q)
    smoothed = smooth_back(filtered, ahead, update(ahead, np.array([0.3]), H, R).state, F)
    assert np.linalg.eigvalsh(filtered.covariance - smoothed.covariance)[0] > -1e-12  # rounding
    np.testing.assert_allclose(smooth_back(filtered, ahead, ahead, F).covariance, filtered.covariance, atol=1e-15)


def test_a_measurement_without_noise_of_what_is_known_exactly_is_refused():
    with pytest.raises(InvalidInput, match="covariance is not positive definite: check for sigma = 0"):
        update(Gaussian(np.zeros(2), np.zeros((2, 2))), np.zeros(1), H, np.zeros((1, 1)))


def test_the_gate_is_the_quantile_of_chi_square():
    assert gate(6) == pytest.approx(22.458, abs=1e-3)  # tables
    assert gate(1, 0.95) == pytest.approx(3.8415, abs=1e-4)


@pytest.mark.parametrize(("scale", "verdict"), [(1.0, "consistent"), (2.0, "overconfident"), (0.5, "underconfident")])
def test_noise_that_is_claimed_too_small_or_too_large_is_told(rng, scale, verdict):
    whitened = scale * rng.normal(size=(2000, 2))
    report = consistency(np.sum(whitened**2, axis=1), np.full(2000, 2), successive(whitened, np.zeros(2000)))
    assert report.verdict == verdict
    assert report.mean_nis == pytest.approx(scale**2, rel=0.1)  # 3 σ of a mean over 4000 numbers
    assert abs(report.autocorrelation) < 2 * report.autocorrelation_limit
    if scale == 1.0:
        assert report.beyond_95 == pytest.approx(0.05, abs=0.015)  # 3 σ of a share of 2000
        assert report.interval[0] < 1 < report.interval[1]


def test_errors_that_last_are_laid_to_the_motion(rng):
    steady = np.convolve(rng.normal(size=3000), np.ones(10) / 2, mode="same")[:, None]
    report = consistency(steady[:, 0] ** 2, np.ones(3000), successive(steady, np.zeros(3000)))
    assert report.autocorrelation > 0.5
    assert "increase --q" in report.warning.text


@pytest.mark.parametrize(("sigma", "q"), [(1.0, 100.0), (0.7, 100.0), (0.3, 100.0)])
def test_a_gain_that_is_too_high_is_told_by_innovations_that_change_sign(rng, sigma, q):
    # A walk that hardly moves, seen with noise of 1: such a filter holds nearly every measurement for the state.
    measured, state = rng.normal(size=2000), Gaussian(np.zeros(1), np.eye(1))
    whitened = []
    for value in measured:
        ahead = predict(state, np.eye(1), np.eye(1) * q * sigma**2)
        found = update(ahead, np.array([value]) - ahead.mean, np.eye(1), np.eye(1) * sigma**2)
        whitened.append((value - ahead.mean) / np.sqrt(found.innovation_covariance[0]))
        state = found.state
    series = np.array(whitened)
    report = consistency(series[:, 0] ** 2, np.ones(len(series)), successive(series, np.zeros(len(series))))
    assert report.verdict == "underconfident"
    assert report.autocorrelation < -0.4  # of differences of white noise: -0.5
    assert report.warning.code == "filter_gain_too_high"
    assert "reduce the process noise, --q" in report.warning.text


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_innovations_of_the_right_size_that_are_correlated_are_not_consistent(rng, sign):
    white = rng.normal(size=1501)
    series = (0.9 * white[1:] + sign * np.sqrt(0.19) * white[:-1])[:, None]  # variance 1
    report = consistency(series[:, 0] ** 2, np.ones(1500), successive(series, np.zeros(1500)))
    assert report.mean_nis == pytest.approx(1, abs=0.15)  # 4 σ
    assert report.verdict == "correlated"
    assert report.warning.code == ("filter_gain_too_high" if sign < 0 else "correlated_innovations")


def test_innovations_are_paired_within_their_chain_over_what_is_missing():
    whitened = np.array([[1.0], [np.nan], [2.0], [3.0], [4.0]])
    first, second = successive(whitened, np.array([0, 0, 0, 1, 1]))
    np.testing.assert_array_equal(np.stack([first, second]), [[1, 3], [2, 4]])


def test_without_innovations_nothing_is_judged():
    report = consistency(np.empty(0), np.empty(0), (np.empty(0), np.empty(0)))
    assert report.verdict == "not judged"
    assert np.isnan(report.mean_nis)


def bearing_model() -> ExtendedModel:
    """A point moving at constant velocity in a plane, seen from the origin by range and bearing."""

    def noise(x, dt):
        return 0.01 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(2))

    def jacobian(x):
        away = np.hypot(x[0], x[1])
        return np.array([[x[0] / away, x[1] / away, 0, 0], [-x[1] / away**2, x[0] / away**2, 0, 0]])

    def difference(measured, expected):
        off = measured - expected
        return np.array([off[0], np.angle(np.exp(1j * off[1]))])

    return ExtendedModel(
        lambda x, dt: np.concatenate([x[:2] + dt * x[2:], x[2:]]),
        lambda x, dt: np.kron([[1.0, dt], [0.0, 1.0]], np.eye(2)),
        noise,
        lambda x: np.array([np.hypot(x[0], x[1]), np.arctan2(x[1], x[0])]),
        jacobian,
        np.diag([0.02, 0.01]) ** 2,
        difference,
    )


def test_an_extended_filter_follows_a_point_across_the_cut_of_its_bearing(rng):
    model = bearing_model()
    stamps = np.arange(100) * 0.1
    truth = np.array([[-3.0, 2.0 - 0.4 * t] for t in stamps])  # passes bearing ±π
    measured = [model.h(np.append(p, [0, 0])) + rng.normal(size=2) * [0.02, 0.01] for p in truth]
    measured = [None if k % 7 == 3 else y for k, y in enumerate(measured)]
    run = extended_filter(model, Gaussian([-3.0, 2.0, 0.0, 0.0], np.diag([0.1, 0.1, 1.0, 1.0])), stamps, measured)
    smoothed = extended_smoother(run)
    causal = np.array([s.mean[:2] for s in run.states]) - truth
    after = np.array([s.mean[:2] for s in smoothed]) - truth
    assert np.sqrt(np.mean(causal**2)) < 0.02  # the bearing alone is 0.03 m here
    assert np.sqrt(np.mean(after**2)) < 0.7 * np.sqrt(np.mean(causal**2))
    assert [step is None for step in run.updates] == [y is None for y in measured]
    nis = np.array([step.nis for step in run.updates if step])
    assert 0.6 < nis.mean() / 2 < 1.4  # 3 σ of a mean over 170 numbers


def test_jacobians_of_the_extended_model_are_its_slopes():
    model, state = bearing_model(), np.array([-3.0, 2.0, 0.3, -0.4])
    moved = check_jacobian(lambda x: model.f(x, 0.1), model.F(state, 0.1), state)
    assert max(moved.error, check_jacobian(model.h, model.H(state), state).error) < 1e-8  # of central differences
