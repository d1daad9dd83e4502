"""A pose as a text of numbers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import pose_text
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

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
        ("left: 1", FileError, "something else than the numbers"),
        ("1 0 0 0  0 2 0 0  0 0 1 0", InvalidInput, "no rotation"),
        ("1 0 0 0  0 1 0 0  0 0 -1 0", InvalidInput, "no rotation"),
        ("1 0 0 0  0 1 0 0  0 0 1 0  1 2 3 1", InvalidInput, "0 0 0 1"),
        ("0 1 2 3  0 0 0 0", InvalidInput, "length 1"),
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
