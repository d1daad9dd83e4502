"""What `camcal handeye` can start from: poses without images, rigs, MATLAB files, poses by another clock or scale."""

import json
import re
from dataclasses import replace

import mat73
import numpy as np
import pytest
from robot_scenes import CARRIER, WORLD, board_at, hand_of, noisy, write_poses

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, detections, frames, native, poses
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile, Transform, ValidRegion
from camcal.formats.poses.record import PixelNoise, PoseKey, PoseRecord
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

BOARD = Board("chessboard", 9, 6, 0.025)
STD = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 2e-3, 1e-4, 1e-4])
LENS = Camera(model_named("opencv4"), (1280, 960), [1100.0, 1101, 640, 478, -0.2, 0.08, 5e-4, -3e-4], np.diag(STD**2))
SHIFT, TURN = 2e-4, 3e-4  # the robot's noise, m and rad
SEEN = (1e-4, 5e-4)  # that of poses of the board
COUNT = 20


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    rng = np.random.default_rng(4)
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(LENS, noise=CalibrationNoise(0.1))}))
    exact = views(LENS, BOARD, COUNT, rng=rng)
    found = observe(LENS, BOARD, exact, noise_px=0.1, rng=rng)[0]
    detections.write(folder / "seen.csv", found)
    robot, seen = noisy(hand_of(exact), SHIFT, TURN, rng), noisy(exact, *SEEN, rng)
    write_poses(folder / "robot.csv", robot)
    write_poses(folder / "named.csv", robot[::-1], before=[view.image for view in found.views][::-1])
    write_poses(folder / "longer.csv", [Pose(pose.rotation, 1.01 * pose.translation) for pose in robot])
    write_poses(folder / "board.csv", seen)
    write_poses(folder / "camera_mm.txt", [pose.inverse() for pose in seen], "euler:xyz:deg", scale=1000)
    covariance = np.diag([SEEN[0] ** 2] * 3 + [SEEN[1] ** 2] * 3)
    records = {
        PoseKey(view.image): PoseRecord(pose, covariance, covariance, "good", 0.1, 0.2, 54, 54)
        for view, pose in zip(found.views, seen, strict=True)
    }
    poses.write(folder / "pnp.yaml", poses.Poses("camera_T_object", "m", PixelNoise(0.1), records))
    return folder


@pytest.fixture
def handeye(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    return lambda *arguments: run("handeye", *arguments, "--overwrite")


def off(transforms):
    """By how many standard deviations hand_T_camera and base_T_board are off, RMS."""
    scores = []
    for name, true in (("hand_T_camera", CARRIER), ("base_T_board", WORLD)):
        apart = transforms[name].pose.translation - true.translation
        scores.append(apart / np.sqrt(np.diag(transforms[name].covariance))[:3])
    return float(np.sqrt(np.mean(np.square(scores))))


@pytest.mark.parametrize(
    ("seen", "robot", "said"),
    [
        ("pnp.yaml", "named.csv", "ros, base_T_hand, m\n"),
        ("board.csv", "robot.csv", "ros, base_T_hand, m; of the board as ros\n"),
        ("camera_mm.txt", "robot.csv", "of the board as euler:xyz:extrinsic:deg, board_T_camera, mm\n"),
    ],
)
def test_poses_of_the_board_do_in_the_place_of_images(handeye, folder, seen, robot, said):
    code, out, err = handeye("--camera-poses", seen, "--robot", robot, "-o", "hand.yaml")
    assert (code, err) == (0, "")
    assert said in out
    found = {each.name: Transform(each.pose, each.covariance) for each in frames.read(folder / "hand.yaml")}
    assert off(found) < 2
    assert np.sqrt(np.diag(found["hand_T_camera"].covariance))[:3].max() < 3e-4


def test_noise_of_poses_without_covariance_counts_as_of_both(handeye):
    document = json.loads(handeye("--camera-poses", "board.csv", "--robot", "robot.csv", "-o", "x.yaml", "--json")[1])
    turn = document["robot_noise"]["rotation_rad"]
    assert turn["low"] < np.hypot(TURN, SEEN[1]) < turn["high"]
    known = json.loads(handeye("--camera-poses", "pnp.yaml", "--robot", "named.csv", "-o", "x.yaml", "--json")[1])
    assert known["robot_noise"]["rotation_rad"]["value"] < 0.8 * turn["value"]
    assert (
        "and of the poses of the board"
        in handeye("--camera-poses", "board.csv", "--robot", "robot.csv", "-o", "x.yaml")[1]
    )


def test_lists_of_poses_that_are_shifted_against_each_other_are_told_in_any_form(handeye, folder):
    robot, camera = ((folder / name).read_text().splitlines() for name in ("robot.csv", "camera_mm.txt"))
    (folder / "later.csv").write_text("\n".join(robot[1:]))
    (folder / "earlier.txt").write_text("\n".join(camera[:-1]))
    code, _, err = handeye("--camera-poses", "earlier.txt", "--robot", "later.csv", "-o", "x.yaml")
    assert (code, "once they are shifted by 1: image 2 belongs to pose 1" in err) == (2, True), err


def test_with_a_camera_file_poses_of_the_board_give_a_camera_file(handeye, folder):
    assert handeye("camera.yaml", "--camera-poses", "board.csv", "--robot", "robot.csv", "-o", "with.yaml")[0] == 0
    found = cameras.read(folder / "with.yaml")
    assert found.joint_covariance is not None
    assert (list(found.cameras), list(found.transforms)) == (["camera"], ["hand_T_camera", "base_T_board"])


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["camera.yaml", "--robot", "robot.csv"], 2, "CAMERA and IMAGES are needed, or --camera-poses"),
        (
            ["camera.yaml", "seen.csv", "--camera-poses", "board.csv", "--robot", "robot.csv"],
            2,
            "in the place of images",
        ),
        (["--camera-poses", "board.csv", "--robot", "named.csv"], 2, "give both, or neither"),
        (["--camera-poses", "squares.yaml", "--robot", "named.csv"], 2, "poses of one object, in metres"),
        (["--camera-poses", "few.csv", "--robot", "few.csv"], 4, "5 or more are needed"),
    ],
)
def test_poses_that_do_not_go_together_are_refused(handeye, folder, arguments, code, said):
    (folder / "few.csv").write_text("\n".join((folder / "board.csv").read_text().splitlines()[:3]))
    poses.write(folder / "squares.yaml", replace(poses.read(folder / "pnp.yaml"), unit="squares"))
    found, _, err = handeye(*arguments, "-o", "x.yaml")
    assert (found, said in err) == (code, True), err


def test_lengths_that_are_wrong_are_named_and_taken_out_where_asked_for(handeye, folder):
    command = ["camera.yaml", "seen.csv", "-o", "x.yaml", "--robot"]
    said = json.loads(handeye(*command, "robot.csv", "--json")[1])["systematic"]["scale"]
    assert not said["significant"]
    assert abs(said["value"]) < 3 * said["std"] < 3e-3
    code, _, err = handeye(*command, "longer.csv")
    assert code == 0
    found = re.search(r"lengths are (\S+) ± \S+ % too long against the board's: correct them", err)
    assert float(found[1]) == pytest.approx(1, abs=0.15)
    wrong = off(cameras.read(folder / "x.yaml").transforms)
    code, _, err = handeye(*command, "longer.csv", "--robot-scale")
    assert (code, "too long" in err, "correct them" in err) == (0, True, False)
    assert off(cameras.read(folder / "x.yaml").transforms) < min(2.5, wrong)


@pytest.mark.parametrize("late", [0.0, 0.123])
def test_the_clock_of_a_moving_robot_is_told(handeye, folder, late):
    rng = np.random.default_rng(6)
    times, stamps = np.sort(rng.uniform(1, 19, 60)), np.arange(0, 20, 0.02)
    write_poses(folder / "film.tum", noisy(map(board_at, times), *SEEN, rng), "tum", before=times.tolist())
    hand = noisy(hand_of(map(board_at, stamps)), SHIFT, TURN, rng)
    write_poses(folder / "moves.tum", hand, "tum", before=(stamps + late).tolist())
    code, out, err = handeye("--camera-poses", "film.tum", "--robot", "moves.tum", "-o", "x.yaml", "--json")
    found = json.loads(out)["systematic"]["delay_s"]
    assert code == 0
    assert abs(found["value"] - late) < 3 * found["std"] < 1e-3
    assert (found["significant"], found["estimated"]) == (late > 0, late > 0)
    assert ("poses are 0.123 ±" in err and "s late, which is taken out" in err) == (late > 0)
    own = {each.name: Transform(each.pose, each.covariance) for each in frames.read(folder / "x.yaml")}
    assert off(own) < 2


def test_a_matlab_file_of_matrices_is_read_either_way_round(handeye, folder):
    from scipy.io import savemat

    rows = np.loadtxt(folder / "robot.csv")
    from camcal.formats.pose_text import form_named

    matrices = np.stack([form_named("ros").parse(row).pose().matrix() for row in rows], axis=2)
    cells = np.empty(COUNT, object)
    cells[:] = [matrices[:, :, place] for place in range(COUNT)]
    tables = {"later": matrices, "before": matrices.transpose(1, 0, 2), "cells": cells, "rows": rows}
    for name, value in tables.items():
        savemat(folder / f"{name}.mat", {"poses": value})
        code, out, _ = handeye("camera.yaml", "seen.csv", "--robot", f"{name}.mat", "-o", "x.yaml")
        assert (code, f"read as {'ros' if name == 'rows' else 'matrix'}, base_T_hand, m" in out) == (0, True), name
    mat73.write(folder / "hdf5.mat", {"poses": matrices})
    assert handeye("camera.yaml", "seen.csv", "--robot", "hdf5.mat", "-o", "x.yaml")[0] == 0
    savemat(folder / "two.mat", {"one": rows, "other": rows})
    savemat(folder / "none.mat", {"words": "poses"})
    (folder / "damaged.mat").write_bytes((folder / "later.mat").read_bytes()[:300])
    for name, said, wanted in (
        ("two", "several variables: one, other", 2),
        ("none", "no array", 2),
        ("damaged", "damaged or truncated", 3),
    ):
        code, _, err = handeye("camera.yaml", "seen.csv", "--robot", f"{name}.mat", "-o", "x.yaml")
        assert (code, said in err) == (wanted, True), err


def test_the_cameras_of_a_rig_are_placed_together(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(8)
    right_T_left = Pose.from_vector(np.array([0.02, -0.1, 0.01]), np.array([-0.1, 0.0, 0.01]))
    exact = list(views(LENS, BOARD, 24, rng=rng))
    entry = CameraEntry(LENS, noise=CalibrationNoise(0.1))
    native.write(
        tmp_path / "rig.yaml", CameraFile({"left": entry, "right": entry}, {"right_T_left": Transform(right_T_left)})
    )
    seen = []
    for name, own in (("left", exact), ("right", [right_T_left @ pose for pose in exact])):
        found = observe(LENS, BOARD, own, noise_px=0.1, rng=rng)[0].views
        seen += [replace(view, camera=name, image=f"{name}{place:02}.png") for place, view in enumerate(found)]
    detections.write(tmp_path / "seen.csv", Detections(BOARD, tuple(seen)))
    write_poses(tmp_path / "robot.csv", noisy(hand_of(exact), SHIFT, TURN, rng))
    code, _, err = run("handeye", "rig.yaml", "seen.csv", "--robot", "robot.csv", "-o", "hand.yaml")
    assert code == 0, err
    found = cameras.read(tmp_path / "hand.yaml")
    assert list(found.transforms) == ["right_T_left", "hand_T_left", "base_T_board"]
    apart = found.transforms["hand_T_left"].pose.translation - CARRIER.translation
    std = np.sqrt(np.diag(found.transforms["hand_T_left"].covariance))[:3]
    assert (np.abs(apart) < 3.5 * std).all()
    assert run("handeye", "rig.yaml#left", "left.csv", "--robot", "robot.csv", "-o", "x.yaml")[0] == 3
    code = run("convert", "hand.yaml", "hand.urdf")[0]
    assert (code, "hand" in (tmp_path / "hand.urdf").read_text()) == (0, True)


def test_a_lens_that_is_estimated_again_has_its_own_region(handeye, folder):
    old = CameraEntry(LENS, ValidRegion(max_radius_px=123.0), noise=CalibrationNoise(0.1))
    native.write(folder / "old.yaml", CameraFile({"camera": old}))
    for option, radius in (([], 123.0), (["--free-lens"], None)):
        assert handeye("old.yaml", "seen.csv", "--robot", "robot.csv", *option, "-o", "x.yaml")[0] == 0
        found = cameras.read(folder / "x.yaml").cameras["camera"]
        expected = ValidRegion.of(found.camera).max_radius_px if radius is None else radius
        assert found.valid.max_radius_px == pytest.approx(expected, rel=1e-6)


def test_a_lens_without_covariance_can_be_free(handeye, folder):
    wrong = Camera(LENS.model, LENS.image_size, LENS.parameters * np.array([1.01, 1.01, 1, 1, 1, 1, 1, 1]))
    native.write(folder / "foreign.yaml", CameraFile({"camera": CameraEntry(wrong)}))
    assert handeye("foreign.yaml", "seen.csv", "--robot", "robot.csv", "--free-lens", "-o", "x.yaml")[0] == 0
    found = cameras.read(folder / "x.yaml").cameras["camera"].camera
    std = np.sqrt(np.diag(found.covariance))
    assert (std > 0).all()
    assert (np.abs(found.parameters - LENS.parameters) < 4 * std).all()
    assert found.parameters[0] == pytest.approx(1100, abs=1.5)


def test_the_page_shows_transforms_noise_and_errors(handeye, folder):
    code, out, _ = handeye("camera.yaml", "seen.csv", "--robot", "longer.csv", "-o", "x.yaml", "--report", "page.html")
    text = (folder / "page.html").read_text()
    assert (code, "wrote x.yaml and page.html" in out) == (0, True)
    for said in (
        "Usable, with",
        "too long against",
        "hand_T_camera",
        "Noise of the robot",
        "Errors of the robot",
        "0003",
    ):
        assert said in text
    assert text.count("data:image/svg+xml") == 4
