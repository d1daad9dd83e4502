"""A pose as a text of numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import pose_text
from camcal.formats.pose_text import form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import NamedTransform, Pose

POSE = Pose.from_vector(np.array([0.3, -0.2, 1.0]), np.array([1.0, -2.0, 3.5]))


def read(tmp_path, text):
    (tmp_path / "pose.txt").write_text(text)
    return pose_text.read(tmp_path / "pose.txt")


@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("ends", [("\n", " "), (" ", " "), ("\n", ", ")])
def test_a_matrix_is_read_however_it_is_laid_out(tmp_path, rows, ends):
    matrix = POSE.matrix()[:rows]
    text = ends[0].join(ends[1].join(f"{number:.6f}" for number in row) for row in matrix)
    found = read(tmp_path, f"# world_T_camera\n{text}\n")
    np.testing.assert_allclose(found.matrix(), POSE.matrix(), atol=1e-6)  # six decimals


def test_a_line_of_the_tum_format_is_read(tmp_path):
    w, x, y, z = so3.to_quaternion(POSE.rotation)
    found = read(tmp_path, f"# time tx ty tz qx qy qz qw\n1305031102.17 1 -2 3.5 {x:.4f} {y:.4f} {z:.4f} {w:.4f}\n")
    np.testing.assert_allclose(found.matrix(), POSE.matrix(), atol=2e-4)  # four decimals


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("1 2 3", InvalidInput, "3 numbers"),
        ("# nothing\n", InvalidInput, "0 numbers"),
        ("left: 1", FileError, "not a list of numbers"),
        ("1 0 0 0  0 2 0 0  0 0 1 0", InvalidInput, "not a rotation: orthonormality error 3"),
        ("1 0 0 0  0 1 0 0  0 0 -1 0", InvalidInput, "a reflection"),
        ("1 0 0 0  0 1 0 0  0 0 1 0  1 2 3 1", InvalidInput, "0 0 0 1"),
        ("0 1 2 3  0 0 0 0", InvalidInput, "quaternion norm is not 1 but 0"),
        ("1 0 0 nan  0 1 0 0  0 0 1 0", InvalidInput, "finite"),
    ],
)
def test_what_is_no_pose_is_refused_by_name(tmp_path, text, error, message):
    with pytest.raises(error, match=message) as raised:
        read(tmp_path, text)
    assert raised.value.where.endswith("pose.txt")


@given(st.text(alphabet="0123456789. -+e#\n", min_size=1))
def test_no_text_is_a_bug(tmp_path_factory, text):
    path = tmp_path_factory.getbasetemp() / "any.txt"
    path.write_text(text)
    try:
        pose = pose_text.read(path)
    except (InvalidInput, FileError):
        return
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-6)  # what Pose asks for


@pytest.mark.parametrize("form", ["matrix", "euler:ZYX:deg", "quat:wxyz", "colmap", "rvec:deg", "ros", "kitti"])
def test_what_is_written_says_its_form_and_name_and_comes_back(tmp_path, form):
    text = pose_text.text_of(NamedTransform("base", "tag", POSE), form_named(form))
    found = read(tmp_path, text)
    np.testing.assert_allclose(found.matrix(), POSE.matrix(), atol=1e-10)  # 12 digits are written
    assert pose_text.name_in(tmp_path / "pose.txt") == "base_T_tag"


def test_the_name_of_a_file_says_the_frames_where_no_remark_does(tmp_path):
    path = tmp_path / "base_T_tag.txt"
    path.write_text("# measured on Monday\n1 0 0 0  0 1 0 0  0 0 1 0\n")
    assert pose_text.name_in(path) == "base_T_tag"


def test_ros_gets_the_line_that_publishes_the_transform():
    text = pose_text.text_of(NamedTransform("base", "tag", Pose.identity()), form_named("ros"))
    assert "--x 0 --y 0 --z 0 --qx 0 --qy 0 --qz 0 --qw 1 --frame-id base --child-frame-id tag" in text


def test_angles_in_gimbal_lock_say_so():
    up = Pose.from_vector(np.array([0, np.pi / 2, 0]), np.zeros(3))
    assert "# gimbal lock" in pose_text.text_of(NamedTransform("a", "b", up), form_named("euler:ZYX:deg"))
    assert "# gimbal lock" not in pose_text.text_of(NamedTransform("a", "b", up), form_named("euler:XZY:deg"))


def test_a_trajectory_is_no_single_pose(tmp_path):
    with pytest.raises(InvalidInput, match="holds 2 poses, one a line"):
        read(tmp_path, "0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 1\n")
