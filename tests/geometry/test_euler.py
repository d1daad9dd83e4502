"""Euler angles: all orders against scipy, hand-worked values, and gimbal lock."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.rotation import EulerOrder, from_euler, to_euler

AXES = [a + b + c for a, b, c in product("xyz", repeat=3) if b not in (a, c)]
ORDERS = [*AXES, *(axes.upper() for axes in AXES)]
ROTATIONS = Rotation.random(40, rng=1).as_matrix()
ANGLES = st.tuples(*[st.floats(-np.pi, np.pi)] * 3).map(np.array)


def test_there_are_twelve_orders_intrinsic_and_extrinsic():
    assert len(set(ORDERS)) == 24


@pytest.mark.parametrize("name", ORDERS)
def test_angles_and_matrices_agree_with_scipy_in_every_order(name):
    order = EulerOrder.named(name)
    angles, locked = to_euler(ROTATIONS, order)
    np.testing.assert_allclose(angles, Rotation.from_matrix(ROTATIONS).as_euler(name), atol=1e-12)
    np.testing.assert_allclose(from_euler(angles, order), ROTATIONS, atol=1e-14)
    assert not locked.any()


@given(ANGLES, st.sampled_from(ORDERS))
def test_any_angles_come_back_as_the_same_rotation(angles, name):
    order = EulerOrder.named(name)
    matrix = from_euler(angles, order)
    found, locked = to_euler(matrix, order)
    # within 1e-7 of gimbal lock the middle angle's cosine is rounded off
    np.testing.assert_allclose(from_euler(found, order), matrix, atol=1e-7 if locked else 1e-12)


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("off", [0.0, 1e-9, 1e-6, 1e-3])
def test_at_gimbal_lock_the_last_angle_is_zero_and_beside_it_the_rotation_is_kept(name, off):
    order = EulerOrder.named(name)
    middle = 0.0 if name[0] == name[2] else np.pi / 2
    for right in (middle, np.pi - middle):
        matrix = from_euler(np.array([0.3, right - off, 0.5]), order)
        angles, locked = to_euler(matrix, order)
        assert locked == (off < 1e-7)
        assert angles[2] == 0 or not locked
        np.testing.assert_allclose(from_euler(angles, order), matrix, atol=2e-9 if locked else 1e-12)


def test_zyx_intrinsic_is_yaw_then_pitch_then_roll_and_xyz_extrinsic_its_reverse():
    yaw, pitch, roll = 0.3, -0.2, 0.1
    expected = so3.about_z(yaw) @ so3.about_y(pitch) @ so3.about_x(roll)
    np.testing.assert_allclose(from_euler(np.array([yaw, pitch, roll]), EulerOrder.named("ZYX")), expected, atol=1e-15)
    np.testing.assert_allclose(from_euler(np.array([roll, pitch, yaw]), EulerOrder.named("xyz")), expected, atol=1e-15)


def test_a_quarter_turn_by_hand():
    # about the moving z, then the moving x: x goes to y, y to z, z to x
    quarter = from_euler(np.array([np.pi / 2, 0.0, np.pi / 2]), EulerOrder.named("ZYX"))
    np.testing.assert_allclose(quarter @ np.eye(3), [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-15)


def test_angles_are_vectorised_over_leading_axes():
    order = EulerOrder.named("XZX")
    angles, locked = to_euler(ROTATIONS.reshape(5, 8, 3, 3), order)
    assert angles.shape == (5, 8, 3)
    assert locked.shape == (5, 8)
    np.testing.assert_array_equal(angles[2, 3], to_euler(ROTATIONS[19], order)[0])


@pytest.mark.parametrize("name", ["", "zy", "zzx", "xyy", "abc", "Zyx", "zyxz"])
def test_what_is_no_order_is_refused(name):
    with pytest.raises(InvalidInput):
        EulerOrder.named(name)
