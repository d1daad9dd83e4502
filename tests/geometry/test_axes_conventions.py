"""What each convention of axes does to x, y and z, and to poses and their covariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.geometry.pose import CONVENTIONS, Pose, change, convention_named, reexpress, reexpress_jacobian

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
NUMBERS = st.floats(-2, 2)
POSES = st.tuples(*[NUMBERS] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))
NAMES = st.sampled_from(sorted(CONVENTIONS))


def minus(vector):
    return tuple(-number for number in vector)


# Where OpenCV's x (right), y (down) and z (forward) go in each convention, by hand.
GOLDEN = {
    "opencv": (X, Y, Z),
    "colmap": (X, Y, Z),
    "ros_optical": (X, Y, Z),
    "opengl": (X, minus(Y), minus(Z)),
    "blender": (X, minus(Y), minus(Z)),
    "nerf": (X, minus(Y), minus(Z)),
    "unity": (X, minus(Y), Z),
    "ros": (minus(Y), minus(Z), X),
    "enu": (X, minus(Z), Y),
    "ned": (Y, Z, X),
}


@pytest.mark.parametrize("name", sorted(CONVENTIONS))
def test_the_axes_of_opencv_go_where_they_should(name):
    matrix = change(convention_named("opencv"), convention_named(name))
    np.testing.assert_array_equal((matrix @ np.eye(3)).T, GOLDEN[name])


def test_every_convention_has_a_golden_value():
    assert set(GOLDEN) == set(CONVENTIONS)


def test_unity_alone_is_left_handed():
    assert [name for name, axes in CONVENTIONS.items() if axes.left_handed] == ["unity"]


@settings(max_examples=30)
@given(NAMES, NAMES, NAMES)
def test_changes_follow_each_other(first, second, third):
    a, b, c = map(convention_named, (first, second, third))
    np.testing.assert_array_equal(change(b, c) @ change(a, b), change(a, c))


@settings(max_examples=30)
@given(POSES, NAMES, NAMES)
def test_a_pose_along_other_axes_moves_points_alike(pose, before, after):
    matrix = change(convention_named(before), convention_named(after))
    moved = reexpress(pose, matrix, matrix)
    point = np.array([0.3, -0.7, 1.9])
    np.testing.assert_allclose(moved.apply(matrix @ point), matrix @ pose.apply(point), atol=1e-12)


@settings(max_examples=20)
@given(POSES, NAMES, NAMES)
def test_the_jacobian_of_other_axes_is_the_derivative_of_the_step(pose, before, after):
    matrix, h = change(convention_named(before), convention_named(after)), 1e-6
    ends = [[reexpress(pose.retract(sign * h * axis), matrix, matrix) for sign in (1, -1)] for axis in np.eye(6)]
    numeric = [
        np.concatenate([ahead.translation - behind.translation, (ahead @ behind.inverse()).vector()]) / (2 * h)
        for ahead, behind in ends
    ]
    # central differences at h = 1e-6 are good to 1e-9
    np.testing.assert_allclose(reexpress_jacobian(matrix), np.column_stack(numeric), atol=1e-8)


def test_one_frame_alone_cannot_become_left_handed():
    mirror = change(convention_named("opencv"), convention_named("unity"))
    with pytest.raises(InvalidInput, match="left-handed"):
        reexpress(Pose.identity(), mirror, np.eye(3))


def test_a_camera_that_looks_along_the_x_of_a_ros_robot():
    # body_T_camera of a camera at the front: optical axes in a body frame, the rotation everybody writes by hand
    aligned = Pose.identity()
    found = reexpress(aligned, change(convention_named("opencv"), convention_named("ros")), np.eye(3))
    np.testing.assert_array_equal(found.rotation, [[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def test_an_unknown_convention_is_refused_naming_all():
    with pytest.raises(InvalidInput, match="opencv, colmap"):
        convention_named("unreal")
