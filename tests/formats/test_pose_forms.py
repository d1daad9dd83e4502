"""Poses as rows of numbers: every form there and back, and against other programs' order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from camcal.errors import InvalidInput
from camcal.formats.pose_text import FORMS, elementary, form_named, guessed, is_elementary, is_row, numbers_in
from camcal.geometry.pose import Pose

NUMBERS = st.floats(-2, 2)
POSES = st.tuples(*[NUMBERS] * 6).map(lambda v: Pose.from_vector(np.array(v[:3]), np.array(v[3:])))
NAMES = [*FORMS, "rvec:deg", "euler:xyz:rad", "euler:zxz:intrinsic:deg", "euler:XYZ:extrinsic:rad"]
POSE = Pose.from_vector(np.array([0.3, -0.2, 1.0]), np.array([1.0, -2.0, 3.5]))
X, Y, Z, W = Rotation.from_matrix(POSE.rotation).as_quat()


@settings(max_examples=60)
@given(POSES, st.sampled_from(NAMES))
def test_every_form_comes_back_as_the_same_pose(pose, name):
    form = form_named(name)
    found = form.parse(form.numbers(pose)).pose()
    # near gimbal lock angles say less of the rotation
    np.testing.assert_allclose(found.matrix(), pose.matrix(), atol=1e-7)


@given(st.sampled_from(NAMES))
def test_a_form_has_a_name_that_stands_for_it(name):
    assert form_named(str(form_named(name))) == form_named(name)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("quat:wxyz", [1, -2, 3.5, W, X, Y, Z]),
        ("quat:xyzw", [1, -2, 3.5, X, Y, Z, W]),
        ("ros", [1, -2, 3.5, X, Y, Z, W]),
        ("tum", [0, 1, -2, 3.5, X, Y, Z, W]),
        ("colmap", [W, X, Y, Z, 1, -2, 3.5]),
        ("rvec", [1, -2, 3.5, 0.3, -0.2, 1.0]),
        ("rvec:deg", [1, -2, 3.5, *np.degrees([0.3, -0.2, 1.0])]),
        ("euler:ZYX:deg", [1, -2, 3.5, *Rotation.from_matrix(POSE.rotation).as_euler("ZYX", degrees=True)]),
        ("euler:ZYX:extrinsic:rad", [1, -2, 3.5, *Rotation.from_matrix(POSE.rotation).as_euler("zyx")]),
        ("kitti", POSE.matrix()[:3].ravel()),
        ("matrix", POSE.matrix().ravel()),
    ],
)
def test_numbers_stand_in_the_order_of_the_form(name, expected):
    np.testing.assert_allclose(form_named(name).numbers(POSE), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        ("quat:wxyz", [W, X, Y, Z]),
        ("quat:xyzw", [X, Y, Z, W]),
        ("rvec", [0.3, -0.2, 1.0]),
        ("matrix", POSE.rotation.ravel()),
        ("euler:ZYX:rad", Rotation.from_matrix(POSE.rotation).as_euler("ZYX")),
    ],
)
def test_a_rotation_alone_has_no_translation(name, numbers):
    found = form_named(name).parse(np.array(numbers)).pose()
    np.testing.assert_allclose(found.rotation, POSE.rotation, atol=1e-12)
    np.testing.assert_array_equal(found.translation, np.zeros(3))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("quat", "quat:wxyz or quat:xyzw"),
        ("quat:wzyx", "quat:wxyz or quat:xyzw"),
        ("euler:ZYX", "their axes and their unit"),
        ("euler:deg", "their axes and their unit"),
        ("euler:ZZX:deg", "is not an order of Euler angles: three of x, y, z without repetition in a row, such as zyx"),
        ("euler:Zyx:deg", "ZYX for intrinsic angles, xyz for extrinsic"),
        ("rvec:grad", "nothing allowed after rvec"),
        ("tum:deg", "nothing allowed after tum"),
        ("matrices", "is unknown; use one of matrix"),
    ],
)
def test_a_form_that_leaves_a_doubt_is_refused(name, message):
    with pytest.raises(InvalidInput, match=message):
        form_named(name)


@pytest.mark.parametrize(("count", "kind"), [(16, "matrix"), (12, "matrix"), (9, "matrix"), (8, "tum")])
def test_counts_that_leave_no_doubt_need_no_form(count, kind):
    assert guessed(count).kind == kind


@pytest.mark.parametrize(
    ("count", "message"), [(7, "quat:wxyz"), (4, "quat:xyzw"), (6, "rvec"), (3, "euler"), (5, "5")]
)
def test_counts_that_leave_a_doubt_are_refused_naming_the_forms(count, message):
    with pytest.raises(InvalidInput, match=message):
        guessed(count)


@pytest.mark.parametrize(
    ("name", "numbers", "message"),
    [
        ("quat:wxyz", [0, 0, 0, 1, 1, 0, 0], "is not 1 but 1.41421"),
        ("quat:wxyz", [0, 0, 0, 0, 0, 0, 0], "is not 1 but 0"),
        ("dual-quat", [0] * 8, "is not 1 but 0"),
        ("dual-quat", [1, 0, 0, 0, 0.5, 0, 0, 0], "at right angles, is off by 0.5"),
        ("matrix", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1], "0 0 0 1"),
        ("kitti", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0], "a reflection"),
        ("rvec", [0, 0, 0, 1e200, 0, 0], "below 1e\\+12"),
        ("rvec", [1, 2], "2 numbers; a pose as rvec has 6 or 3"),
    ],
)
def test_numbers_that_are_no_pose_say_why(name, numbers, message):
    with pytest.raises(InvalidInput, match=message):
        form_named(name).parse(np.array(numbers, dtype=float)).pose()


@pytest.mark.parametrize("text", ["1 -2 3e-1", "[1, -2, 0.3]", "(1; -2; .3)", " 1,\n-2\t0.3 "])
def test_numbers_are_read_with_any_brackets_and_commas(text):
    np.testing.assert_allclose(numbers_in(text), [1, -2, 0.3])


@pytest.mark.parametrize("text", ["pose.txt", "1 2 x", "1_0 2", "1 2 0x3", "", " "])
def test_what_is_no_row_of_numbers_is_known(text):
    assert not is_row(text)
    with pytest.raises(InvalidInput, match="not a list of numbers"):
        numbers_in(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Rx(90deg)", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ("Ry(-90 deg)", [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
        (" Rz( 1.5707963267948966rad ) ", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    ],
)
def test_turns_about_an_axis_by_hand(text, expected):
    assert is_elementary(text)
    np.testing.assert_allclose(elementary(text).pose().rotation, expected, atol=1e-15)


@pytest.mark.parametrize("text", ["Rx(90)", "Rx(deg)", "Rz(adeg)", "Rz()"])
def test_a_turn_without_an_angle_and_its_unit_is_refused(text):
    assert is_elementary(text)
    with pytest.raises(InvalidInput, match="with its unit"):
        elementary(text)


@pytest.mark.parametrize("text", ["1 nan", "inf", "1e999"])
def test_numbers_that_are_not_finite_are_refused(text):
    with pytest.raises(InvalidInput, match="finite"):
        numbers_in(text)
