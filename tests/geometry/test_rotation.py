"""Rotations against scipy, against their own definitions, and along a walk of angles down to 1e-12."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from camcal.geometry import rotation as so3
from camcal.solve.differentiate import central_jacobian

VECTORS = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) < np.pi)
ANGLES = np.concatenate([[3.1, 1.0], 10.0 ** -np.arange(1, 13)])


@given(VECTORS)
def test_exp_agrees_with_scipy(vector):
    np.testing.assert_allclose(so3.exp(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)


@given(VECTORS)
def test_log_inverts_exp(vector):
    # near π the axis is known to the root of the rounding error only
    np.testing.assert_allclose(so3.log(so3.exp(vector)), vector, atol=1e-7)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_keeps_its_relative_accuracy_at_every_angle(angle):
    vector = angle * np.array([0.6, 0.0, -0.8])
    np.testing.assert_allclose(so3.log(so3.exp(vector)), vector, rtol=1e-9, atol=1e-16)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_jacobian_is_the_derivative_of_exp(angle):
    vector = angle * np.array([0.36, 0.48, 0.8])
    numeric = central_jacobian(lambda d: so3.log(so3.exp(vector + d) @ so3.exp(vector).T), np.zeros(3), 1e-3)
    np.testing.assert_allclose(so3.exp_jacobian(vector), numeric, atol=1e-11)  # of numbers near 1, extrapolated


@given(VECTORS)
def test_quaternions_round_trip_and_agree_with_scipy(vector):
    matrix = so3.exp(vector)
    quaternion = so3.to_quaternion(matrix)
    expected = Rotation.from_matrix(matrix).as_quat(canonical=True, scalar_first=True)
    assert min(np.abs(quaternion - expected).max(), np.abs(quaternion + expected).max()) < 1e-12
    np.testing.assert_allclose(so3.from_quaternion(quaternion), matrix, atol=1e-14)


def test_half_turns_have_a_logarithm():
    for axis in np.eye(3):
        vector = so3.log(so3.exp(np.pi * axis))
        np.testing.assert_allclose(np.abs(vector), np.pi * axis, atol=1e-12)


def test_elementary_rotations_turn_the_next_axis_towards_the_one_after():
    np.testing.assert_allclose(so3.about_x(np.pi / 2) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(so3.about_y(np.pi / 2) @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(so3.about_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_nearest_rotation_undoes_a_small_stretch_and_never_mirrors():
    matrix = so3.exp(np.array([0.1, -0.2, 0.3]))
    np.testing.assert_allclose(so3.nearest(matrix @ np.diag([1.01, 1.0, 0.99])), matrix, atol=0.01)
    assert np.linalg.det(so3.nearest(np.diag([1.0, 1.0, -0.1]))) == pytest.approx(1.0)


def test_functions_are_vectorised_over_leading_axes():
    vectors = np.random.default_rng(1).normal(size=(2, 5, 3)) * 0.5
    stacked = so3.exp(vectors)
    assert stacked.shape == (2, 5, 3, 3)
    np.testing.assert_array_equal(stacked[1, 3], so3.exp(vectors[1, 3]))
    assert so3.log(stacked).shape == vectors.shape


def test_the_angle_between_two_rotations_is_that_of_the_turn_that_joins_them():
    first = so3.exp(np.array([0.3, -1.0, 0.4]))
    for angle in ANGLES:
        turn = so3.exp(angle * np.array([0.6, 0.0, -0.8]))
        # a product of matrices is rounded to 1e-16
        np.testing.assert_allclose(so3.angle_between(first, turn @ first), angle, rtol=1e-9, atol=1e-15)
    stacked = np.stack([first, np.eye(3)])
    np.testing.assert_allclose(so3.angle_between(stacked, stacked), [0, 0], atol=1e-15)


def test_a_share_of_the_way_between_two_rotations_is_an_even_turn():
    first, axis = so3.exp(np.array([0.4, -1.1, 0.3])), np.array([0.6, 0.0, 0.8])
    shares = np.array([0.0, 0.25, 1.0])
    found = so3.between(first, so3.exp(2.0 * axis) @ first, shares)
    np.testing.assert_allclose(found, so3.exp(2.0 * shares[:, None] * axis) @ first, atol=1e-14)
