"""Unit dual quaternions: round trips, a value by hand, and their product as composition."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.geometry.pose import Pose
from camcal.geometry.rotation import dual_quaternion_error, from_dual_quaternion, to_dual_quaternion

POSES = st.tuples(*[st.floats(-2, 2)] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))


@settings(max_examples=30)
@given(POSES, st.floats(0.1, 10))
def test_poses_come_back_whatever_the_length(pose, length):
    dual = to_dual_quaternion(pose.rotation, pose.translation)
    rotation, translation = from_dual_quaternion(length * dual)
    np.testing.assert_allclose(rotation, pose.rotation, atol=1e-13)
    np.testing.assert_allclose(translation, pose.translation, atol=1e-13)
    assert dual_quaternion_error(dual) < 1e-14


def test_a_quarter_turn_about_z_and_a_step_along_x_by_hand():
    pose = Pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([2.0, 0, 0]))
    half = np.sqrt(0.5)
    # half of (2 i)(h + h k) = h i - h j
    np.testing.assert_allclose(
        to_dual_quaternion(pose.rotation, pose.translation), [half, 0, 0, half, 0, half, -half, 0], atol=1e-15
    )


def test_they_are_vectorised_over_leading_axes():
    rotations, translations = np.broadcast_to(np.eye(3), (2, 4, 3, 3)), np.arange(24.0).reshape(2, 4, 3)
    dual = to_dual_quaternion(rotations, translations)
    assert dual.shape == (2, 4, 8)
    np.testing.assert_allclose(from_dual_quaternion(dual)[1], translations)
