"""Linear systems over time: filter, smoother, batch, robust loss, noise from the measurements."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.smoothing.batch import disagreement, smooth_system, solve_batch
from camcal.estimate.smoothing.linear_system import LinearSystem, MotionModel, kalman_filter, rts
from camcal.estimate.smoothing.series import Series, SeriesOptions, log_likelihood, series_at, smooth_series, system_of

SIGMA, STRENGTH = 0.05, 2.0


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def moving(rng, count=400, model="cv", dt=1 / 30, axes=1, form="continuous"):
    """Return stamps (K,), true positions (K, d) and measurements with sigma SIGMA of something that moves so."""
    motion = MotionModel(model, form)
    F, noise = motion.transition(np.array([dt]))[0], STRENGTH * motion.noise(np.array([dt]))[0]
    values, vectors = np.linalg.eigh(noise)
    root = vectors * np.sqrt(np.maximum(values, 0))
    state, truth = np.zeros((axes, len(F))), []
    for _ in range(count):
        truth.append(state[:, 0].copy())
        state = state @ F.T + rng.normal(size=state.shape) @ root.T
    truth = np.array(truth)
    return np.arange(count) * dt, truth, truth + SIGMA * rng.normal(size=truth.shape)


def system(rng, count=200, model="cv", holes=True, controls=False) -> LinearSystem:
    stamps, _, values = moving(rng, count, model, axes=2)
    if holes:
        values[rng.random(values.shape) < 0.2] = np.nan
        values[0] = np.nan
    inputs = rng.normal(size=values.shape) if controls else None
    series = Series(("x", "y"), stamps, values, np.full(values.shape, SIGMA), inputs)
    unit = system_of(series, MotionModel(model))
    return replace(unit, process=STRENGTH * unit.process)


@pytest.mark.parametrize("model", ["rw", "cv", "ca"])
@given(first=st.floats(1e-3, 10.0), second=st.floats(1e-3, 10.0))
def test_two_steps_of_continuous_noise_are_one_double_step(model, first, second):
    motion = MotionModel(model)
    steps = np.array([first, second, first + second])
    F, Q = motion.transition(steps), motion.noise(steps)
    np.testing.assert_allclose(F[1] @ F[0], F[2], rtol=1e-12)
    np.testing.assert_allclose(F[1] @ Q[0] @ F[1].T + Q[1], Q[2], rtol=1e-10)


def test_two_steps_of_the_textbooks_noise_are_not_one_double_step():
    motion = MotionModel("cv", "discrete")
    F, Q = motion.transition(np.array([1.0]))[0], motion.noise(np.array([1.0, 2.0]))
    np.testing.assert_allclose(F @ Q[0] @ F.T + Q[0], [[2.5, 2], [2, 2]])
    np.testing.assert_allclose(Q[1], [[4, 4], [4, 4]])
    assert np.linalg.matrix_rank(Q[0]) == 1


def test_the_batch_is_the_smoother_to_rounding(rng):
    found = system(rng, 500, "rw", holes=False, controls=True)
    batch, smoothed = solve_batch(found).smoothed(), rts(found, kalman_filter(found))
    np.testing.assert_allclose(batch[0], smoothed[0], atol=1e-12)
    np.testing.assert_allclose(batch[1], smoothed[1], atol=1e-14)


@pytest.mark.parametrize(("model", "digits"), [("cv", 1e-9), ("ca", 1e-6)])  # the faster a model, the worse conditioned
def test_the_batch_is_the_smoother_with_holes_and_before_all_is_observed(rng, model, digits):
    found = system(rng, 150, model)
    batch, smoothed = solve_batch(found).smoothed(), rts(found, kalman_filter(found))
    np.testing.assert_allclose(batch[0], smoothed[0], atol=digits)
    np.testing.assert_allclose(batch[1], smoothed[1], atol=digits)


def test_the_batch_is_the_dense_maximum_of_likelihood_with_controls(rng):
    controls, values = rng.normal(size=12), rng.normal(size=12)
    series = Series(("x",), np.arange(12.0), values[:, None], np.full((12, 1), 0.3), controls[:, None])
    found = smooth_series(series, SeriesOptions(MotionModel("rw"), 0.25, "batch"))
    # x_k = x_{k-1} + u_k + w_k, y_k = x_k + n_k: rows of the stacked, whitened system
    motion = (np.eye(12)[1:] - np.eye(12)[:-1]) / 0.5
    rows = np.vstack([motion, np.eye(12) / 0.3])
    right = np.concatenate([controls[1:] / 0.5, values / 0.3])
    expected, *_ = np.linalg.lstsq(rows, right, rcond=None)
    np.testing.assert_allclose(found.states[:, 0, 0], expected, atol=1e-12)
    np.testing.assert_allclose(found.covariances[:, 0, 0, 0], np.diag(np.linalg.inv(rows.T @ rows)), atol=1e-12)


def test_likelihoods_of_batch_and_filter_differ_by_what_noise_does_not_change(rng):
    found = system(rng)
    double = replace(found, process=3 * found.process, noise=2 * found.noise)
    gaps = [solve_batch(each).log_likelihood - kalman_filter(each).log_likelihood for each in (found, double)]
    assert gaps[0] == pytest.approx(gaps[1], abs=1e-6)


def test_a_chain_knows_nothing_of_another(rng):
    both = system(rng, 60)
    other = both.measurements.copy()
    other[60:] += 5.0
    moved = replace(both, measurements=other)
    np.testing.assert_allclose(solve_batch(both).means[:60], solve_batch(moved).means[:60], atol=1e-12)


@pytest.mark.parametrize(("model", "measured", "missing"), [("cv", 1, [1]), ("ca", 2, [1, 2]), ("rw", 0, [0])])
def test_states_that_are_not_observed_are_named(model, measured, missing):
    values = np.full((5, 1), np.nan)
    values[:measured] = 1.0
    series = Series(("height",), np.arange(5.0), values, np.ones((5, 1)))
    motion = MotionModel(model)
    found = system_of(series, motion)
    assert set(found.unobserved()[0]) >= set(missing)
    with pytest.raises(InsufficientData, match=f"{motion.states[missing[0]]} of height"):
        smooth_series(series, SeriesOptions(motion, 1.0))
    with pytest.raises(InsufficientData, match="not"):
        solve_batch(found)


def test_the_filter_starts_from_measurements_and_not_from_a_guess(rng):
    found = system(rng, 50, holes=False)
    filtered = kalman_filter(found)
    assert [state is None for state in filtered.predicted[:3]] == [True, True, False]
    slope = (found.measurements[1, 0] - found.measurements[0, 0]) * 30
    assert filtered.states[1].mean[1] == pytest.approx(slope, rel=1e-9)


def test_noise_of_rank_one_is_smoothed_by_rts_and_refused_by_the_batch(rng):
    stamps, truth, values = moving(rng, 200, form="discrete")
    series = Series(("x",), stamps, values, np.full(values.shape, SIGMA))
    found = smooth_series(series, SeriesOptions(MotionModel("cv", "discrete"), STRENGTH))
    assert np.sqrt(np.mean((found.states[:, :, 0] - truth) ** 2)) < 0.5 * SIGMA
    with pytest.raises(InvalidInput, match="rank 1"):
        smooth_series(series, SeriesOptions(MotionModel("cv", "discrete"), STRENGTH, "batch"))


@pytest.mark.parametrize("known", [True, False])
def test_noise_is_found_from_the_measurements(rng, known):
    stamps, truth, values = moving(rng, 600, axes=2)
    series = Series(("x", "y"), stamps, values, np.full(values.shape, SIGMA) if known else None)
    found = smooth_series(series, SeriesOptions(method="batch"))
    assert found.q == pytest.approx(STRENGTH, rel=0.6)  # 3 σ of what 20 s of motion tell
    if not known:
        assert found.sigma == pytest.approx(SIGMA, rel=0.1)  # 3 σ over 1200 numbers
    off = (found.states[:, :, 0] - truth) ** 2
    assert np.mean(off / found.covariances[:, :, 0, 0]) == pytest.approx(1, abs=0.4)  # 3 σ of correlated errors
    assert found.consistency.verdict == "consistent"


def test_no_other_noise_near_is_more_likely(rng):
    stamps, _, values = moving(rng, 300)
    series = Series(("x",), stamps, values, np.full(values.shape, SIGMA))
    found = smooth_series(series)
    unit = system_of(series, MotionModel())
    best, less, more = (
        log_likelihood(replace(unit, process=factor * found.q * unit.process)) for factor in (1, 0.8, 1.25)
    )
    assert best > max(less, more)


def test_outliers_are_listed_and_pull_little_when_smoothed_robustly(rng):
    stamps, truth, values = moving(rng, 300)
    wrong = np.sort(rng.choice(300, 20, replace=False))
    values[wrong] += rng.choice([-1.0, 1.0], (20, 1)) * rng.uniform(0.5, 3.0, (20, 1))
    series = Series(("x",), stamps, values, np.full(values.shape, SIGMA))
    plain, robust = (smooth_series(series, SeriesOptions(q=STRENGTH, method="batch", robust=r)) for r in (False, True))
    errors = [np.sqrt(np.mean((each.states[:, :, 0] - truth) ** 2)) for each in (plain, robust)]
    assert errors[1] < 0.3 * errors[0]
    assert set(wrong) <= set(np.flatnonzero(robust.outliers[:, 0]))
    assert robust.outliers.sum() <= 22  # one in a thousand of the good ones, and a little
    assert (robust.weights[wrong] < 0.5).all()
    assert robust.consistency.verdict == "consistent"


def test_noise_found_robustly_is_that_of_the_good_measurements(rng):
    stamps, _, values = moving(rng, 250)
    values[rng.choice(250, 12, replace=False)] += 2.0
    found = smooth_series(Series(("x",), stamps, values), SeriesOptions(robust=True, method="batch"))
    assert found.sigma == pytest.approx(SIGMA, rel=0.25)  # 3 σ, and gated noise is a little smaller
    assert found.q == pytest.approx(STRENGTH, rel=0.9)


def test_disagreement_is_what_smoothing_without_a_measurement_says(rng):
    found = system(rng, 30, holes=False)
    k = 12
    means, covariances = solve_batch(found.without(np.arange(len(found)) == k)).smoothed()
    off = found.measurements[k, 0] - means[k, 0]
    expected = off**2 / (covariances[k, 0, 0] + SIGMA**2)
    squares = disagreement(found, np.ones(len(found)), *solve_batch(found).smoothed())
    assert squares[k] == pytest.approx(expected, rel=1e-6)


def test_states_between_measurements_are_those_a_filter_would_pass_through(rng):
    stamps, _, values = moving(rng, 120)
    series = Series(("x",), stamps, values, np.full(values.shape, SIGMA))
    smoothed = smooth_series(series, SeriesOptions(q=STRENGTH))
    found = series_at(smoothed, np.array([stamps[10], stamps[10] + 1e-7, 0.5 * (stamps[10] + stamps[11])]))
    np.testing.assert_allclose(found.states[0], smoothed.states[10], atol=1e-9)
    np.testing.assert_allclose(found.states[1], smoothed.states[10], atol=1e-5)
    ends = sorted([smoothed.states[10, 0, 0], smoothed.states[11, 0, 0]])
    assert ends[0] - 0.01 < found.states[2, 0, 0] < ends[1] + 0.01  # it cannot turn much within 1/60 s
    assert found.covariances[2, 0, 0, 0] < smoothed.covariances[10, 0, 0, 0] * 1.1


def test_a_filter_told_the_textbooks_measurement_noise_is_wrong_by_orders(rng):
    """R = dt⁴/4 has nothing to do with the sensor: the filter believes its measurements and says so falsely."""
    dt = 1 / 30
    stamps, truth, values = moving(rng, 300, dt=dt)
    right = smooth_series(Series(("x",), stamps, values, np.full(values.shape, SIGMA)), SeriesOptions(q=STRENGTH))
    textbook = smooth_series(
        Series(("x",), stamps, values, np.full(values.shape, dt**2 / 2)), SeriesOptions(q=STRENGTH)
    )
    assert right.consistency.mean_nis == pytest.approx(1, abs=0.25)  # 3 σ over 300 numbers
    assert textbook.consistency.mean_nis > 100
    assert textbook.consistency.warning.code == "overconfident"
    errors = [np.sqrt(np.mean((each.states[:, 0, 0] - truth[:, 0]) ** 2)) for each in (right, textbook)]
    assert errors[1] > 1.5 * errors[0]


def test_process_noise_of_zero_is_refused_by_the_batch():
    series = Series(("x",), np.arange(5.0), np.arange(5.0)[:, None], np.ones((5, 1)))
    found = system_of(series, MotionModel())
    with pytest.raises(InvalidInput, match="without inverse"):
        solve_batch(replace(found, process=0 * found.process))
    means, _, _ = smooth_system(replace(found, process=0 * found.process))
    np.testing.assert_allclose(means[:, 1], 1.0, atol=1e-9)  # a straight line


def test_stamps_that_do_not_increase_are_refused():
    with pytest.raises(InvalidInput, match="not later"):
        Series(("x",), np.array([0.0, 1.0, 1.0]), np.zeros((3, 1)))


def test_a_covariance_that_is_none_is_refused(rng):
    found = system(rng, 20, holes=False)
    noise = found.noise.copy()
    noise[3] = 0.0
    for solve in (solve_batch, lambda each: smooth_system(each, "batch")):
        with pytest.raises(InvalidInput, match="covariance is not positive definite: check for sigma = 0"):
            solve(replace(found, noise=noise))


def test_noise_so_unlike_in_size_that_digits_are_lost_is_refused(rng):
    found = system(rng, 20)
    with pytest.raises(InsufficientData, match="differ too much in magnitude"):
        solve_batch(replace(found, process=1e-40 * found.process))
