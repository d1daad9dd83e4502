"""Jitter of poses, and rotation vectors in less time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.estimate.poses.states import rotation_vectors
from camcal.estimate.tracking.process_noise import jitter
from camcal.geometry import rotation as so3


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_rotation_vectors_are_those_of_the_logarithm(vector):
    rotation = so3.exp(np.array(vector))
    # the arc tangent of sine and cosine loses digits towards a half turn, where the logarithm takes over
    np.testing.assert_allclose(rotation_vectors(rotation), so3.log(rotation), atol=1e-12)


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
