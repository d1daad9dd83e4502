"""Poses: the algebra of frames, the retraction, and the one golden test of the order tx ty tz rx ry rz."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose, compose_jacobians, inverse_jacobian, point_jacobian
from camcal.solve.differentiate import central_jacobian

NUMBERS = st.floats(-2, 2)
POSES = st.tuples(*[NUMBERS] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))
TIGHT = 1e-10  # of lengths of some metres: rounding over steps of 1e-3, and what extrapolation leaves


def step_to(here, there):
    """The step (6,) that takes one pose to another: translation first, then rotation."""
    return np.concatenate([there.translation - here.translation, (there @ here.inverse()).vector()])


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
    point = np.array([0.4, -0.7, 1.3])
    numeric = central_jacobian(lambda d: pose.retract(d).apply(point), np.zeros(6), 1e-3)
    np.testing.assert_allclose(point_jacobian(pose.rotation @ point), numeric, atol=TIGHT)


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
    numeric = central_jacobian(lambda d: step_to(pose.inverse(), pose.retract(d).inverse()), np.zeros(6), 1e-3)
    np.testing.assert_allclose(inverse_jacobian(pose), numeric, atol=TIGHT)


@settings(max_examples=20)
@given(POSES, POSES)
def test_compose_jacobians_are_the_step_of_the_product_by_the_steps_of_its_factors(a_T_b, b_T_c):
    product = a_T_b @ b_T_c
    first = central_jacobian(lambda d: step_to(product, a_T_b.retract(d) @ b_T_c), np.zeros(6), 1e-3)
    second = central_jacobian(lambda d: step_to(product, a_T_b @ b_T_c.retract(d)), np.zeros(6), 1e-3)
    for analytic, numeric in zip(compose_jacobians(a_T_b, b_T_c), (first, second), strict=True):
        np.testing.assert_allclose(analytic, numeric, atol=TIGHT)
