"""The steps of the pose filter: against plain formulas, and against each other."""

import numpy as np
import pytest
from camcal.estimate.tracking.pose_filter import Candidates, FilterState
from hypothesis import given
from hypothesis import strategies as st

from camcal.estimate.smoothing import kalman
from camcal.estimate.tracking import pose_filter
from camcal.estimate.tracking.jitter import jitter
from camcal.geometry import rotation as so3

NOISE = np.array([0.02, 0.5])


def belief(seed=0, count=None):
    rng = np.random.default_rng(seed)
    shape = () if count is None else (count,)
    roots = rng.normal(size=(*shape, 12, 12)) * 0.05
    return FilterState(
        so3.exp(rng.normal(size=(*shape, 3))),
        rng.normal(size=(*shape, 3)),
        rng.normal(size=(*shape, 6)),
        roots @ roots.swapaxes(-1, -2) + 1e-6 * np.eye(12),
    )


def candidates(about, seed=1, count=2):
    rng = np.random.default_rng(seed)
    rotations = so3.exp(0.02 * rng.normal(size=(count, 3))) @ about.rotations
    translations = about.translations + 0.02 * rng.normal(size=(count, 3))
    return Candidates(
        rotations, translations, np.tile(1e-4 * np.eye(6), (count, 1, 1)), np.array([0.0, *[1.5] * (count - 1)])
    )


def test_two_steps_add_the_noise_of_one_step_of_their_length():
    still = belief()._replace(velocities=np.zeros(6), covariances=np.zeros((12, 12)))
    once, _ = pose_filter.predict(still, NOISE, np.array(0.3))
    half, _ = pose_filter.predict(still, NOISE, np.array(0.1))
    twice, _ = pose_filter.predict(half, NOISE, np.array(0.2))
    np.testing.assert_allclose(twice.covariances, once.covariances, atol=1e-16)
    np.testing.assert_allclose(once.covariances[[0, 0, 6], [0, 6, 6]], 0.02 * np.array([0.3**3 / 3, 0.3**2 / 2, 0.3]))


def test_errors_grow_as_the_transition_says():
    state, dt = belief(3), np.array(0.05)
    later, growth = pose_filter.predict(state, NOISE, dt)
    step = 1e-6
    for column in range(12):
        off = pose_filter.moved(state, step * np.eye(12)[column], state.covariances)
        off_later, _ = pose_filter.predict(off, NOISE, dt)
        change = np.concatenate(
            [
                off_later.translations - later.translations,
                so3.log(off_later.rotations @ later.rotations.T),
                off_later.velocities - later.velocities,
            ]
        )
        # three terms of the left Jacobian leave |ω dt|³ / 24, some 1e-4 of dt here; differences leave 1e-6
        np.testing.assert_allclose(change / step, growth[:, column], atol=2e-5)


def test_an_update_is_that_of_the_linear_filter():
    state = belief()
    seen = candidates(state, count=1)
    after, verdict = pose_filter.update(state, seen, np.inf)
    innovation = np.append(seen.translations[0] - state.translations, so3.log(seen.rotations[0] @ state.rotations.T))
    linear = kalman.update(
        kalman.Gaussian(np.zeros(12), state.covariances), innovation, np.eye(6, 12), seen.covariances[0]
    )
    np.testing.assert_allclose(after.covariances, linear.state.covariance, atol=1e-12)
    np.testing.assert_allclose(after.translations - state.translations, linear.state.mean[:3], atol=1e-12)
    np.testing.assert_allclose(so3.log(after.rotations @ state.rotations.T), linear.state.mean[3:6], atol=1e-12)
    assert verdict.nis == pytest.approx(linear.nis)
    assert -verdict.cost / 2 - 3 * np.log(2 * np.pi) == pytest.approx(linear.log_likelihood)


def test_many_filters_at_once_do_what_each_does_alone():
    states = belief(5, count=3)
    single = [FilterState(*(part[index] for part in states)) for index in range(3)]
    seen = candidates(single[0])
    together, verdicts = pose_filter.update(
        *_predicted(states), pose_filter.Candidates(*(part[None] for part in seen)), 30.0
    )
    for index, state in enumerate(single):
        alone, verdict = pose_filter.update(*_predicted(state), seen, 30.0)
        for part, whole in zip(alone, together, strict=True):
            np.testing.assert_allclose(part, whole[index], atol=1e-12)
        assert verdict.chosen == verdicts.chosen[index]
        assert verdict.accepted == verdicts.accepted[index]


def _predicted(state):
    return (pose_filter.predict(state, NOISE, np.array(0.1))[0],)


def test_the_order_of_candidates_does_not_matter():
    state = belief()
    seen = candidates(state)
    turned = Candidates(*(part[::-1] for part in seen))
    first, one = pose_filter.update(state, seen, 100.0)
    second, other = pose_filter.update(state, turned, 100.0)
    np.testing.assert_array_equal(first.translations, second.translations)
    assert one.chosen == 1 - other.chosen


def test_a_candidate_outside_the_gate_changes_nothing():
    state = belief()
    after, verdict = pose_filter.update(state, candidates(state), 1e-9)
    assert not verdict.accepted
    np.testing.assert_array_equal(after.translations, state.translations)
    np.testing.assert_allclose(after.covariances, state.covariances, atol=1e-18)


def test_a_frame_without_candidates_changes_nothing_and_costs_nothing():
    state = belief()
    seen = candidates(state)._replace(penalties=np.full(2, np.inf))
    after, verdict = pose_filter.update(state, seen, 1e9)
    assert not verdict.accepted
    assert verdict.cost == 0
    np.testing.assert_array_equal(after.rotations, state.rotations)


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_rotation_vectors_are_those_of_the_logarithm(vector):
    rotation = so3.exp(np.array(vector))
    # the arc tangent of sine and cosine loses digits towards a half turn, where the logarithm takes over
    np.testing.assert_allclose(pose_filter.rotation_vectors(rotation), so3.log(rotation), atol=1e-12)


def test_jitter_of_white_noise_is_its_standard_deviation_and_of_steady_motion_nothing():
    rng = np.random.default_rng(7)
    stamps = np.cumsum(rng.uniform(0.02, 0.05, 4000))
    rotations = so3.exp(stamps[:, None] * [0.1, 0.2, -0.1])
    places = stamps[:, None] * [0.5, 0.0, 0.1]
    chains = np.zeros(len(stamps))
    steady = jitter(stamps, rotations, places, chains)
    assert max(steady.translation, steady.rotation) < 1e-12
    noise = rng.normal(size=(len(stamps), 6)) * 0.01
    shaken = jitter(stamps, so3.exp(noise[:, 3:]) @ rotations, places + noise[:, :3], chains)
    assert shaken.translation == pytest.approx(0.01 * np.sqrt(3), rel=0.05)  # 3 standard errors
    assert shaken.rotation == pytest.approx(0.01 * np.sqrt(3), rel=0.05)


def test_jitter_of_two_poses_is_not_known():
    found = jitter(np.array([0.0, 1.0]), np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3)), np.zeros(2))
    assert np.isnan(found.translation)
