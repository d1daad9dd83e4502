"""Mirrored poses of flat objects, and tracks that pass the frontal view with no frame to tell which way."""

import numpy as np

from camcal.estimate.tracking.hypotheses import MISSED, Hypotheses, with_mirrored
from camcal.estimate.tracking.measurements import ObjectPlane
from camcal.estimate.tracking.motion import MotionState
from camcal.geometry import rotation as so3

TAG = ObjectPlane(np.array([0.0, 0.0, 1.0]), np.zeros(3))


def test_mirrored_states_turn_as_the_mirrored_poses_do():
    rng = np.random.default_rng(4)
    step = 1e-6
    rates = np.zeros((5, 2, 6))
    rates[:, 0, 3:] = rng.normal(size=(5, 3))
    now = MotionState(so3.exp(rng.normal(size=(5, 3))), np.tile([0.0, 0.0, 2.0], (5, 1)), rates)
    later = so3.exp(step * rates[:, 0, 3:]) @ now.rotations
    mirrored = TAG.mirrored_states(now)
    turned, _ = TAG.mirrored(later, now.translations)
    seen = so3.log(turned @ mirrored.rotations.swapaxes(-1, -2)) / step
    np.testing.assert_allclose(mirrored.rates[:, 0, 3:], seen, atol=1e-6)


def test_a_state_mirrored_twice_is_the_same():
    rng = np.random.default_rng(5)
    now = MotionState(so3.exp(rng.normal(size=(5, 3))), rng.normal([0, 0, 1], 0.1, (5, 3)), rng.normal(size=(5, 1, 6)))
    twice = TAG.mirrored_states(TAG.mirrored_states(now))
    for one, other in zip(now, twice, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_mirrored_pose_is_as_far_from_the_line_of_sight():
    rng = np.random.default_rng(6)
    rotations, places = so3.exp(rng.normal(size=(6, 3))), rng.normal([0, 0, 1], 0.1, (6, 3))
    np.testing.assert_allclose(TAG.tilt(*TAG.mirrored(rotations, places)), TAG.tilt(rotations, places), atol=1e-7)


def nearly(tilt, costs):
    """Return hypotheses of tags that turn slowly, at tilts (K), rad."""
    count = len(tilt)
    rotations = so3.exp(np.array(tilt)[:, None] * [1.0, 0.0, 0.0]) @ so3.about_x(np.pi)
    rates = np.tile([0.0, 0.0, 0.0, 0.3, 0.1, 0.2], (count, 1, 1))
    states = MotionState(rotations, np.tile([0.0, 0.0, 1.5], (count, 1)), rates)
    spread = np.tile(1e-4 * np.eye(12), (count, 1, 1))
    kinds, unseen = np.full(count, MISSED), np.full((count, 6), np.nan)
    return Hypotheses(states, spread, np.array(costs), states, spread, spread, np.arange(count), kinds, unseen)


def test_nearly_frontal_hypotheses_are_joined_by_their_mirrored_ones():
    known = nearly([0.1, 0.6], [0.0, 3.0])
    found = with_mirrored(known, TAG)
    assert len(found.costs) == 3
    np.testing.assert_allclose(found.states.rotations[2], TAG.mirrored_states(known.states).rotations[0], atol=1e-12)
    assert found.costs[2] > known.costs[0]
    assert found.parents[2] == 0


def test_a_mirrored_hypothesis_that_is_there_already_or_no_rival_is_not_added():
    known = nearly([0.1, -0.1], [0.0, 3.0])
    assert len(with_mirrored(known, TAG).costs) == 2
    known = nearly([0.6, 0.1], [0.0, 27.0])
    assert len(with_mirrored(known, TAG).costs) == 2
