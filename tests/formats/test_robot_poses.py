"""Poses of robots in the ways that robots and people write them."""

import json

import numpy as np
import pytest

from camcal.errors import FileError, InvalidInput
from camcal.formats import robot_poses
from camcal.formats.pose_text import Form
from camcal.geometry.pose import Pose

POSES = [Pose.from_vector(np.array([0.1 * k, 0.3, -0.2]), np.array([0.4, 0.1 * k, 0.5])) for k in range(3)]
ROS = [Form("ros").numbers(pose) for pose in POSES]


def read(folder, name, text):
    (folder / name).write_text(text, encoding="utf-8")
    return robot_poses.read(folder / name)


def lines(numbers, separator=" "):
    return "".join(separator.join(map(repr, map(float, row))) + "\n" for row in numbers)


@pytest.mark.parametrize("separator", [" ", ",", ", ", ";", "\t"])
def test_rows_of_numbers_with_a_header_and_without(tmp_path, separator):
    text = f"# a remark\nx{separator}y{separator}z\n" + lines(ROS, separator)
    found = read(tmp_path, "poses.csv", text)
    np.testing.assert_array_equal(found.numbers, ROS)
    assert found.names is None


def test_names_of_images_stand_before_the_numbers(tmp_path):
    text = "".join(f'"view {k}.png",' + lines([row], ",") for k, row in enumerate(ROS)).replace(" ", "_")
    found = read(tmp_path, "poses.csv", text)
    assert found.names == ("view_0.png", "view_1.png", "view_2.png")
    np.testing.assert_array_equal(found.numbers, ROS)


def test_matrices_on_lines_of_four(tmp_path):
    found = read(tmp_path, "poses.txt", "\n".join(lines(pose.matrix()) for pose in POSES))
    np.testing.assert_array_equal(found.numbers, [pose.matrix().ravel() for pose in POSES])


@pytest.mark.parametrize(
    "wrap",
    [
        lambda poses: poses,
        lambda poses: {"poses": poses},
        lambda poses: [{"image": f"{k}.png", "pose": each} for k, each in enumerate(poses)],
    ],
)
def test_lists_of_json_and_yaml(tmp_path, wrap):
    matrices = [pose.matrix().tolist() for pose in POSES]
    found = read(tmp_path, "poses.json", json.dumps(wrap(matrices)))
    np.testing.assert_array_equal(found.numbers, [pose.matrix().ravel() for pose in POSES])
    keys = ("x", "y", "z"), ("x", "y", "z", "w")
    messages = [
        {"position": dict(zip(keys[0], row[:3], strict=True)), "orientation": dict(zip(keys[1], row[3:], strict=True))}
        for row in np.array(ROS).tolist()
    ]
    found = read(tmp_path, "poses.yaml", json.dumps(wrap(messages)))
    np.testing.assert_array_equal(found.numbers, ROS)


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        ("# nothing\n", FileError, "holds no poses"),
        ("a b c\n", FileError, "holds no poses"),
        ("1 2 3 4 5\n", InvalidInput, "rows of 5 numbers; a pose has 6, 7, 8, 12 or 16"),
        ("1 2 3 4 5 6\n1 2 3 4 5 6 7\n", InvalidInput, "rows of 6 and 7 numbers"),
        ("1 2 3 4 5 inf\n", InvalidInput, "not finite"),
    ],
)
def test_what_is_no_list_of_poses_is_refused(tmp_path, text, error, said):
    with pytest.raises(error, match=said):
        read(tmp_path, "poses.txt", text)


def test_rows_have_the_forms_of_their_count():
    counts = {count: len(robot_poses.RobotRows(np.zeros((2, count))).forms()) for count in (6, 7, 8, 12, 16)}
    assert counts == {6: 50, 7: 3, 8: 2, 12: 1, 16: 1}
