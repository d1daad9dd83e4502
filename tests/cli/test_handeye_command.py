"""`camcal handeye` as it is called from a shell."""

import json
from dataclasses import replace

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, detections, native
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile
from camcal.formats.pose_text import form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board
from camcal.targets.detection import Detections

BOARD = Board("chessboard", 9, 6, 0.025)
STD = np.array([0.5, 0.5, 0.5, 0.5, 1e-3, 2e-3, 1e-4, 1e-4])
LENS = Camera(model_named("opencv4"), (1280, 960), [1100.0, 1101, 640, 478, -0.2, 0.08, 5e-4, -3e-4], np.diag(STD**2))
CARRIER = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.05, -0.02, 0.08]))
WORLD = Pose.from_vector(np.array([0.02, 3.1, 0.03]), np.array([0.6, 0.1, 0.02]))
COUNT = 14


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """camera.yaml, seen.csv, and poses of the robot: robot.csv by order, named.csv, inverse.txt in mm and degrees."""
    folder = tmp_path_factory.mktemp("robot")
    native.write(folder / "camera.yaml", CameraFile({"camera": CameraEntry(LENS, noise=CalibrationNoise(0.1))}))
    rng = np.random.default_rng(1)
    poses = views(LENS, BOARD, COUNT, rng=rng)
    found = observe(LENS, BOARD, poses, noise_px=0.1, rng=rng)[0]
    detections.write(folder / "seen.csv", found)
    robot = [WORLD @ pose.inverse() @ CARRIER.inverse() for pose in poses]
    robot = [Pose(pose.rotation, pose.translation + rng.normal(0, 2e-4, 3)) for pose in robot]
    for name, form, own, scale in (
        ("robot.csv", "ros", robot, 1),
        ("inverse.txt", "euler:ZYX:deg", [pose.inverse() for pose in robot], 1000),
        ("shifted.csv", "ros", robot[1:] + robot[:1], 1),
    ):
        rows = [form_named(form).numbers(Pose(pose.rotation, scale * pose.translation)) for pose in own]
        text = [",".join(map(repr, row.tolist())) for row in rows]
        (folder / name).write_text("\n".join(text) + "\n")
        if name == "robot.csv":
            named = [f"{view.image},{row}" for view, row in zip(found.views, text, strict=True)]
            (folder / "named.csv").write_text("\n".join(named[::-1]) + "\n")
    return folder


@pytest.fixture
def handeye(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    return lambda robot, *options: run(
        "handeye", "camera.yaml", "seen.csv", "--robot", robot, "-o", "hand.yaml", "--overwrite", *options
    )


@pytest.mark.parametrize(
    ("robot", "said"),
    [
        ("robot.csv", "ros, base_T_hand, m"),
        ("named.csv", "ros, base_T_hand, m"),
        ("inverse.txt", "euler:ZYX:intrinsic:deg, hand_T_base, mm"),
    ],
)
def test_the_camera_stands_where_it_does_however_the_poses_are_written(handeye, folder, robot, said):
    code, out, _ = handeye(robot)
    assert code == 0
    assert f"Poses of the robot read as {said}" in out
    assert "Noise of the robot: position 0." in out
    file = cameras.read(folder / "hand.yaml")
    assert list(file.transforms) == ["hand_T_camera", "base_T_board"]
    for name, true in (("hand_T_camera", CARRIER), ("base_T_board", WORLD)):
        pose, std = file.transforms[name].pose, np.sqrt(np.diag(file.transforms[name].covariance))
        assert np.abs(pose.translation - true.translation).max() < 3e-4
        assert (np.abs(pose.translation - true.translation) < 4 * std[:3]).all()


def test_the_document(handeye):
    code, out, _ = handeye("robot.csv", "--json")
    found = json.loads(out)
    assert (code, found["schema"], found["read_as"]) == (0, "camcal/handeye/1", "ros, base_T_hand, m")
    noise = found["robot_noise"]["position_m"]
    assert noise["low"] < 2e-4 < noise["high"]
    assert len(found["poses"]) == COUNT
    assert sorted(found["poses"][0]) == ["image", "rotation_vector", "shift_m", "weight"]
    assert sorted(found["transforms"]["hand_T_camera"]) == ["R", "covariance", "t_m"]


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["robot.csv", "--robot-frames", "hand_T_base"], 2, "give --robot-frames base_T_hand"),
        (["robot.csv", "--robot-form", "quat:wxyz"], 2, "give --robot-form ros"),
        (["inverse.txt", "--robot-unit", "m"], 2, "give --robot-unit mm"),
        (["shifted.csv"], 2, "shifted by 1: image 2 belongs to pose 1"),
        (["misnamed.csv"], 2, "the names of other images: that of image 2 belongs to image 1"),
        (["few.csv"], 2, f"3 poses for {COUNT} images"),
        (["some.csv"], 4, "3 images with the board and a pose of the robot; 5 or more are needed"),
        (["one_axis.csv"], 4, "the hand turned about one axis only"),
        (["missing.csv"], 3, "missing.csv"),
    ],
)
def test_what_is_wrong_with_poses_is_named_and_the_remedy_helps(handeye, folder, arguments, code, said):
    rows = (folder / "robot.csv").read_text().splitlines()
    (folder / "few.csv").write_text("\n".join(rows[:3]))
    first, *named = (folder / "named.csv").read_text().splitlines()
    texts = [row.partition(",") for row in named]
    wrong = [",".join((here[0], there[2])) for here, there in zip(texts, [*texts[1:], texts[0]], strict=True)]
    (folder / "misnamed.csv").write_text("\n".join([first, *wrong]))
    (folder / "some.csv").write_text("\n".join((folder / "named.csv").read_text().splitlines()[:3]))
    about = [Pose.from_vector(np.array([0.0, 0.0, 0.1 * k]), np.array([0.1 * k, 0.0, 0.3])) for k in range(COUNT)]
    turned = [",".join(map(repr, form_named("ros").numbers(pose).tolist())) for pose in about]
    (folder / "one_axis.csv").write_text("\n".join(turned))
    found, _, err = handeye(*arguments)
    assert (found, said in err) == (code, True), err
    if "give --" in said:
        assert handeye(arguments[0], *said.removeprefix("give ").split())[0] == 0


def test_a_free_lens_is_written_as_it_was_estimated(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    other = Camera(LENS.model, LENS.image_size, LENS.parameters * [1.005, 1.005, 1, 1, 1, 1, 1, 1], LENS.covariance)
    native.write(folder / "off.yaml", CameraFile({"camera": CameraEntry(other, noise=CalibrationNoise(0.1))}))
    command = ["handeye", "off.yaml", "seen.csv", "--robot", "robot.csv", "-o", "free.yaml", "--overwrite"]
    assert run(*command)[0] == 0
    assert cameras.read_camera(folder / "free.yaml").value("fx") == pytest.approx(other.value("fx"))
    assert run(*command, "--free-lens")[0] == 0
    found = cameras.read_camera(folder / "free.yaml")
    assert abs(found.value("fx") - 1100) < 4 * found.std("fx") < 8


def test_images_of_another_camera_and_poses_of_other_moments_are_told(run, handeye, folder, monkeypatch):
    monkeypatch.chdir(folder)
    other = Camera(LENS.model, LENS.image_size, LENS.parameters * [0.6, 0.6, 1, 1, 2, 1, 1, 1], LENS.covariance)
    native.write(folder / "other.yaml", CameraFile({"camera": CameraEntry(other, noise=CalibrationNoise(0.1))}))
    code, _, err = run("handeye", "other.yaml", "seen.csv", "--robot", "robot.csv", "-o", "x.yaml")
    assert (code, "px with this lens: the images are of another camera" in err) == (2, True)
    rng = np.random.default_rng(2)
    rows = np.loadtxt(folder / "robot.csv", delimiter=",")
    rows[:, :3] += rng.normal(0, 0.02, (COUNT, 3))
    (folder / "shaken.csv").write_text("\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    code, _, err = handeye("shaken.csv")
    assert (code, "mm and" in err and "more than any robot has" in err) == (0, True)


def test_a_board_without_a_size_is_refused(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    squares = Board("chessboard", 9, 6)
    detections.write(folder / "squares.csv", Detections(squares, detections.read(folder / "seen.csv", BOARD).views))
    code, _, err = run("handeye", "camera.yaml", "squares.csv", "--robot", "robot.csv", "-o", "x.yaml")
    assert (code, "give the size of the board's squares" in err) == (2, True)


def test_with_the_board_in_the_hand_the_camera_stands_in_the_base(handeye, folder):
    inverse = [
        form_named("ros").parse(np.array(row.split(","), float)).pose().inverse()
        for row in (folder / "robot.csv").read_text().split()
    ]
    rows = [",".join(map(repr, form_named("ros").numbers(pose).tolist())) for pose in inverse]
    (folder / "held.csv").write_text("\n".join(rows))
    code, _, _ = handeye("held.csv", "--eye-to-hand")
    file = cameras.read(folder / "hand.yaml")
    assert (code, list(file.transforms)) == (0, ["base_T_camera", "hand_T_board"])
    assert np.abs(file.transforms["base_T_camera"].pose.translation - CARRIER.translation).max() < 3e-4


def uncertainty(path, middle):
    """The standard deviation (m) of the place of what a camera on a hand sees at a point of its frame."""
    known = cameras.read(path).transforms["hand_T_camera"]
    reach = np.hstack([np.eye(3), -so3.hat(known.pose.rotation @ middle)])
    return np.sqrt(np.trace(reach @ known.covariance @ reach.T))


def test_hand_and_eye_are_known_after_suggested_poses_as_well_as_forecast(run, folder, monkeypatch):
    monkeypatch.chdir(folder)
    sharp = Camera(LENS.model, LENS.image_size, LENS.parameters, 1e-6 * LENS.covariance)
    native.write(folder / "sharp.yaml", CameraFile({"camera": CameraEntry(sharp, noise=CalibrationNoise(0.1))}))
    given = ("handeye", "sharp.yaml", "seen.csv", "--robot", "robot.csv", "-o", "sharp_hand.yaml")
    noise = json.loads(run(*given, "--json")[1])["robot_noise"]
    words = f"{noise['position_m']['value']}m,{np.degrees(noise['rotation_rad']['value'])}deg"
    code, out, _ = run("advise", "sharp_hand.yaml", "--robot", words, "--views", 10, "--json")
    advice = json.loads(out)
    assert code == 0
    seen = [each["camera_T_board"] for each in advice["poses"]]
    poses = [Pose.from_vector(np.array(own["rotation_vector"]), np.array(own["t"])) for own in seen]
    rng = np.random.default_rng(8)
    more = observe(LENS, BOARD, poses, noise_px=0.1, rng=rng)[0]
    robot = [WORLD @ pose.inverse() @ CARRIER.inverse() for pose in poses]
    robot = [Pose(pose.rotation, pose.translation + rng.normal(0, 2e-4, 3)) for pose in robot]
    rows = [",".join(map(repr, form_named("ros").numbers(pose).tolist())) for pose in robot]
    before = detections.read(folder / "seen.csv")
    views_of_both = [replace(view, image=f"{n:03d}.png") for n, view in enumerate((*before.views, *more.views))]
    detections.write(folder / "both.csv", replace(before, views=tuple(views_of_both)))
    (folder / "both.txt").write_text((folder / "robot.csv").read_text() + "\n".join(rows) + "\n")
    middle = np.array([0.0, 0.0, np.mean([pose.translation[2] for pose in poses])])
    first = uncertainty(folder / "sharp_hand.yaml", middle)
    command = ("handeye", "sharp.yaml", "both.csv", "--robot", "both.txt", "-o", "after.yaml", "--overwrite")
    assert run(*command)[0] == 0
    lower = advice["poses"][-1]["uncertainty_m"] / advice["uncertainty_m"]
    assert uncertainty(folder / "after.yaml", middle) / first == pytest.approx(lower, rel=0.25)
    assert lower < 0.75


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ("camera.yaml", "--robot", "0.5mm,0.1deg", "-b", "chessboard:9x6:25mm"),
            "has no hand_T_camera and base_T_board",
        ),
        (("hand.yaml", "--robot", "0.5mm"), "'0.5mm' is not noise such as 0.5mm,0.06deg"),
        (("hand.yaml", "--robot", "0.5mm,0.1deg", "-o", "next.png"), "--robot has no picture"),
        (("hand.yaml", "--robot", "0.5mm,0.1deg", "--model", "opencv5"), "applies to detections"),
    ],
)
def test_what_is_no_file_of_hand_and_eye_gets_no_poses_of_the_hand(run, handeye, words, said):
    assert handeye("robot.csv")[0] == 0
    code, _, err = run("advise", *words)
    assert (code, said in err) == (2, True), err
