"""`camcal simulate` with the cameras of a rig, and of a board that moves: what is written, and what is refused."""

import json
from itertools import pairwise

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform, pose_between
from camcal.formats.poses import read as read_poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.targets.board import parse_board

BOARD = "chessboard:7x5:25mm"
SMALL = ("--views", "5", "--jobs", "1", "--quiet")
LEFT = Camera(model_named("opencv4"), (160, 120), np.array([140, 140, 80, 59, -0.1, 0, 0, 0.0]))
RIGHT = Camera(model_named("kannala_brandt4"), (200, 150), np.array([90, 91, 99, 75, 0.02, 0, 0, 0.0]))


def written(path, right):
    transform = Transform(Pose.from_vector(np.array(right[:3]), np.array(right[3:])), 1e-6 * np.eye(6))
    file = CameraFile({"left": CameraEntry(LEFT), "right": CameraEntry(RIGHT)}, transforms={"right_T_left": transform})
    native.write(path, file)
    return path


@pytest.fixture
def rig(tmp_path):
    return written(tmp_path / "rig.yaml", [0.02, -0.05, 0.01, -0.1, 0.002, 0.001])


def poses(folder):
    return {key.image: record.transform for key, record in read_poses(folder / "poses.csv").estimates.items()}


def test_every_camera_of_a_rig_photographs_the_same_board(run, rig, tmp_path):
    scene = tmp_path / "scene"
    code, out, err = run("simulate", BOARD, rig, "-o", scene, *SMALL, "--json")
    assert (code, err, json.loads(out)["cameras"]) == (0, "", ["left", "right"])
    found, truth = poses(scene), native.read(scene / "truth.yaml")
    right_T_left = pose_between(truth, "right", "left")
    assert np.allclose(right_T_left.matrix(), pose_between(native.read(rig), "right", "left").matrix(), atol=1e-9)
    assert truth.transforms["right_T_left"].covariance is None
    for number in range(5):
        name = f"view{number:04d}.png"
        assert {(scene / "images" / camera / name).exists() for camera in ("left", "right")} == {True}
        expected = right_T_left @ found[f"left/{name}"]
        assert np.allclose(found[f"right/{name}"].matrix(), expected.matrix(), atol=1e-9)
    for view in detections.read(scene / "corners.csv").views:
        points = parse_board(BOARD).points()[view.ids]
        pixels = truth.cameras[view.camera].camera.project(found[view.image].apply(points)).pixels
        assert np.abs(pixels - view.pixels).max() < 1e-3  # digits of the poses
        assert len(view.ids) == 35  # the whole board, in both


@pytest.mark.slow
def test_a_rig_that_was_simulated_is_calibrated_to_its_truth(run, rig, tmp_path):
    run("simulate", BOARD, rig, "-o", tmp_path / "scene", "--views", "12", "-j", 1, "-q")
    command = ("rig", tmp_path / "scene" / "corners.csv", "--board", BOARD, "-o", tmp_path / "found.yaml", "-j", 1)
    assert run(*command, "--model", "left=opencv4", "--model", "right=kannala_brandt4", "-q")[0] == 0
    pose = pose_between(native.read(tmp_path / "found.yaml"), "right", "left")
    true = pose_between(native.read(rig), "right", "left")
    assert np.abs(pose.translation - true.translation).max() < 1e-5  # m; the corners have no noise
    assert np.linalg.norm(so3.log(pose.rotation @ true.rotation.T)) < 1e-4


def test_one_camera_of_a_rig_is_still_simulated_alone_and_images_of_others_are_removed(run, rig, tmp_path):
    scene = tmp_path / "scene"
    run("simulate", BOARD, rig, "-o", scene, *SMALL)
    assert run("simulate", BOARD, f"{rig}#right", "-o", scene, *SMALL)[0] == 0
    assert sorted(path.name for path in (scene / "images").rglob("*.png")) == [f"view000{n}.png" for n in range(5)]
    assert list(native.read(scene / "truth.yaml").cameras) == ["camera"]


def test_cameras_without_a_common_view_are_refused(run, tmp_path):
    apart = written(tmp_path / "apart.yaml", [0.0, np.pi, 0.0, 0.0, 0.0, 0.0])
    code, _, err = run("simulate", BOARD, apart, "-o", tmp_path / "scene", *SMALL)
    assert code == 2
    assert "found 0 of 5 poses of the board" in err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--motion",), "are of one camera: choose it with --camera"),
        (("--raw", "RGGB", "--flats", "3"), "are of one camera: choose it with --camera"),
        (("--fov", "60"), "a camera file excludes"),
    ],
)
def test_what_a_rig_cannot_do_is_refused(run, rig, tmp_path, options, said):
    code, _, err = run("simulate", BOARD, rig, "-o", tmp_path / "scene", *SMALL, *options)
    assert (code, err.count("\n")) == (2, 1)
    assert said in err
    assert not (tmp_path / "scene").exists()


@pytest.mark.slow
def test_a_moving_board_moves_smoothly_and_rests_at_its_first_pose(run, tmp_path):
    small = ("--size", "96x72", "-j", "1", "-q")
    assert run("simulate", BOARD, "-o", tmp_path / "scene", "--motion", "--views", "40", *small)[0] == 0
    assert run("simulate", BOARD, "-o", tmp_path / "apart", "--views", "40", *small)[0] == 0
    steps = {name: largest_step(list(poses(tmp_path / name).values())) for name in ("scene", "apart")}
    assert steps["scene"] < 0.1 * steps["apart"]  # a leg has 30 frames, and the fastest step is 1.5 times the mean
    first, second, third = list(poses(tmp_path / "scene").values())[:3]
    assert largest_step([first, second]) < 0.5 * largest_step([second, third])
    assert native.read(tmp_path / "scene" / "truth.yaml").extra["x_simulation"]["motion"] is True


def largest_step(path):
    return max(np.linalg.norm(b.translation - a.translation) for a, b in pairwise(path))


def test_motion_and_views_that_are_cut_exclude_each_other(run, tmp_path):
    code, _, err = run("simulate", BOARD, "-o", tmp_path / "scene", "--motion", "--partial")
    assert (code, err) == (2, "camcal: error: --motion excludes --partial\n")
