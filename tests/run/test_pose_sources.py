"""Poses as arguments of a command: numbers, files, names and addresses."""

import numpy as np
import pytest

from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import poses
from camcal.formats.pose_text import form_named
from camcal.formats.poses.record import PixelNoise, PoseKey, PoseRecord, Poses
from camcal.geometry.pose import Pose
from camcal.run.pose_sources import files_of, read_loose, read_one, read_transforms

FRAMES = """transforms:
  base_T_cam: {rotation_vector: [0.0, 0.0, 0.0], t: [1.0, 0.0, 0.0], std: [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]}
  tag_T_cam: {rotation_vector: [0.0, 0.0, 0.0], t: [0.0, 2.0, 0.0], std: [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]}
"""
RVEC = form_named("rvec")


@pytest.fixture
def frames(tmp_path):
    (tmp_path / "frames.yaml").write_text(FRAMES)
    return tmp_path / "frames.yaml"


def test_numbers_are_a_pose_without_a_name():
    (found,) = read_transforms(["1 -2 3 0 0 0.5"], RVEC)
    assert found.name == ""
    np.testing.assert_array_equal(found.pose.translation, [1, -2, 3])


def test_single_numbers_are_one_pose_together():
    (found,) = read_transforms(["1", " -2", "3", "0", "0", "0.5"], RVEC)
    np.testing.assert_allclose(found.pose.vector(), [0, 0, 0.5])


def test_a_name_before_numbers_or_a_file_says_the_frames(tmp_path):
    (tmp_path / "pose.txt").write_text("1 0 0 5  0 1 0 6  0 0 1 7")
    for text in ("base_T_cam=1 0 0 5 0 1 0 6 0 0 1 7", f"base_T_cam={tmp_path / 'pose.txt'}"):
        found = read_one(text)
        assert (found.target, found.source) == ("base", "cam")
        np.testing.assert_array_equal(found.pose.translation, [5, 6, 7])


def test_a_file_stands_for_all_its_transforms_and_an_address_for_one(frames):
    assert [item.name for item in read_transforms([str(frames)])] == ["base_T_cam", "tag_T_cam"]
    assert read_one(f"{frames}#tag_T_cam").name == "tag_T_cam"


def test_an_address_that_is_not_there_may_follow_from_others(frames):
    found = read_one(f"{frames}#base_T_tag")
    np.testing.assert_array_equal(found.pose.translation, [1, -2, 0])
    np.testing.assert_allclose(np.diag(found.covariance)[:3], 0.02)  # both are uncertain by 0.1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{frames}", "holds 2 transforms; choose one"),
        ("{frames}#base_T_lidar", "no frame 'lidar'"),
        ("{frames}#image.png", "no pose named 'image.png'"),
        ("a_T_b={frames}", "a_T_b is one transform, the file has 2"),
        ("1 2 3", "numbers are ambiguous; choose a form: "),
        ("1 2 3 nan", "finite"),
    ],
)
def test_what_does_not_say_one_pose_is_refused(frames, text, message):
    with pytest.raises(InvalidInput, match=message):
        read_one(text.format(frames=frames))


def test_a_missing_file_is_named():
    with pytest.raises(FileError, match=r"nowhere\.yaml: no such file"):
        read_one("nowhere.yaml")


@pytest.mark.parametrize("name", ["poses.yaml", "poses.csv"])
def test_poses_of_a_pose_file_are_told_by_their_image(tmp_path, name):
    record = PoseRecord(Pose(np.eye(3), np.array([0, 0, 2.0])), np.eye(6), np.eye(6), "ok", 0.1, 0.2, 4, 4)
    found = Poses("camera_T_object", "m", PixelNoise(0.3), {PoseKey("a.png"): record, PoseKey("b.png"): record})
    path = str(tmp_path / name)
    poses.write(tmp_path / name, found)
    one = read_one(f"{path}#b.png")
    assert one.name == "camera_T_object"
    np.testing.assert_array_equal(one.covariance, np.eye(6))
    assert len(read_transforms([path])) == 2
    assert [item.where for item in read_loose([path])] == [f"{path}#a.png", f"{path}#b.png"]
    (loose,) = read_loose([f"{path}#b.png"])
    np.testing.assert_array_equal(loose.pose.translation, [0, 0, 2])


def test_a_file_without_transforms_is_too_little(tmp_path):
    (tmp_path / "none.yaml").write_text("transforms: {}\n")
    for read in (read_transforms, read_loose):
        with pytest.raises(InsufficientData, match=r"none\.yaml: holds no transforms"):
            read([str(tmp_path / "none.yaml")])
    assert read_transforms([str(tmp_path / "none.yaml")], allow_none=True) == ()


def test_what_is_no_rotation_is_read_loosely_all_the_same():
    (found,) = read_loose(["1 0 0 0 0 1 0 0 0 0 -1 0"])
    assert np.linalg.det(found.pose.matrix) == -1
    with pytest.raises(InvalidInput, match="reflection"):
        found.named()


def test_files_among_arguments_are_known(frames):
    assert files_of(["1 2 3", f"{frames}#base_T_cam", "a_T_b=1 2 3", "a_T_b=pose.txt"])[0] == frames
    assert len(files_of(["1 2 3", "a_T_b=pose.txt"])) == 1


def test_lengths_in_squares_are_no_transforms(tmp_path):
    record = PoseRecord(Pose.identity(), np.eye(6), np.eye(6), "ok", 0.1, 0.2, 4, 4)
    poses.write(
        tmp_path / "poses.csv", Poses("camera_T_object", "squares", PixelNoise(0.3), {PoseKey("a.png"): record})
    )
    with pytest.raises(InvalidInput, match="lengths are in squares"):
        read_one(str(tmp_path / "poses.csv"))
