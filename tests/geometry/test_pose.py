"""Poses: the algebra of frames, the retraction, and the one golden test of the order tx ty tz rx ry rz."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose, compose_jacobians, inverse_jacobian, point_jacobian

NUMBERS = st.floats(-2, 2)
POSES = st.tuples(*[NUMBERS] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))


@given(POSES, POSES)
def test_composition_applies_the_right_hand_pose_first(a_T_b, b_T_c):
    point = np.array([0.3, -1.2, 2.0])
    np.testing.assert_allclose((a_T_b @ b_T_c).apply(point), a_T_b.apply(b_T_c.apply(point)), atol=1e-12)


@given(POSES)
def test_inverse_undoes(pose):
    np.testing.assert_allclose((pose @ pose.inverse()).matrix(), np.eye(4), atol=1e-12)


def test_steps_are_translation_first_then_rotation():
    moved = Pose.identity().retract(np.array([1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(moved.translation, [1, 2, 3])
    np.testing.assert_allclose(moved.apply(np.array([1.0, 0, 0])), [1, 3, 3], atol=1e-15)


@given(POSES)
def test_point_jacobian_is_the_derivative_of_the_moved_point(pose):
    point, h = np.array([0.4, -0.7, 1.3]), 1e-6
    numeric = [
        (pose.retract(h * axis).apply(point) - pose.retract(-h * axis).apply(point)) / (2 * h) for axis in np.eye(6)
    ]
    # central differences at h = 1e-6 are good to 1e-9
    np.testing.assert_allclose(point_jacobian(pose.rotation @ point), np.column_stack(numeric), atol=1e-8)


def test_a_matrix_that_is_no_rotation_is_refused():
    with pytest.raises(InvalidInput, match="not a rotation"):
        Pose(np.diag([1.0, 1.0, 1.1]), np.zeros(3))
    with pytest.raises(InvalidInput, match="not a rotation"):
        Pose(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_poses_cannot_be_changed_in_place():
    pose = Pose.identity()
    with pytest.raises(ValueError, match="read-only"):
        pose.translation[0] = 1.0


@given(POSES)
def test_inverse_jacobian_is_the_step_of_the_inverse_by_the_step_of_the_pose(pose):
    h = 1e-6
    ends = [[pose.retract(sign * h * axis).inverse() for sign in (1, -1)] for axis in np.eye(6)]
    numeric = [
        np.concatenate([ahead.translation - behind.translation, (ahead @ behind.inverse()).vector()]) / (2 * h)
        for ahead, behind in ends
    ]
    # central differences at h = 1e-6 are good to 1e-9
    np.testing.assert_allclose(inverse_jacobian(pose), np.column_stack(numeric), atol=1e-8)


@settings(max_examples=20)
@given(POSES, POSES)
def test_compose_jacobians_are_the_step_of_the_product_by_the_steps_of_its_factors(a_T_b, b_T_c):
    h = 1e-6
    first = [[a_T_b.retract(sign * h * axis) @ b_T_c for sign in (1, -1)] for axis in np.eye(6)]
    second = [[a_T_b @ b_T_c.retract(sign * h * axis) for sign in (1, -1)] for axis in np.eye(6)]
    for analytic, ends in zip(compose_jacobians(a_T_b, b_T_c), (first, second), strict=True):
        numeric = [
            np.concatenate([ahead.translation - behind.translation, (ahead @ behind.inverse()).vector()]) / (2 * h)
            for ahead, behind in ends
        ]
        # central differences at h = 1e-6 are good to 1e-9
        np.testing.assert_allclose(analytic, np.column_stack(numeric), atol=1e-8)
