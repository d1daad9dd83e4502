"""Cameras of a part of their images, for every command that takes a camera: as if `convert` had written it before."""

import json
import re

import cv2
import numpy as np
import pytest
from command_page import REGISTERED

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import cameras, detections, native
from camcal.formats.camera_file import CalibrationNoise, CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.simulate.scene import observe, views
from camcal.targets.board import parse_board
from camcal.targets.detection import Detections

BOARD = parse_board("chessboard:9x6:25mm")
STD = np.array([0.5, 0.5, 0.4, 0.4, 1e-3, 2e-3, 1e-4, 1e-4, 1e-3])
LENS = Camera(
    model_named("opencv5"), (752, 480), [458.6, 457.3, 367.2, 248.4, -0.2, 0.05, 1e-4, -1e-4, 0.01], np.diag(STD**2)
)
PART = ("--crop", "640x400+60+30", "--binning", "2", "--scale-to", "160x100")
ORIGIN = {"timings", "converted_from", "provenance", "path", "command"}
FLAGS = {"--crop", "--binning", "--scale-to"}
ITS_OWN = {  # what is asked of these is about the calibration itself: its images, or the views to take next
    "advise",
    "report",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A camera, a rig, what convert makes of them, and detections in the converted camera's images."""
    folder = tmp_path_factory.mktemp("parts")
    entry = CameraEntry(LENS, noise=CalibrationNoise(0.1))
    native.write(folder / "camera.yaml", CameraFile({"camera": entry}))
    pair = {"right_T_left": Transform(Pose(np.eye(3), np.array([-0.1, 0.0, 0.0])))}
    native.write(folder / "rig.yaml", CameraFile({"left": entry, "right": entry}, pair))
    small = Camera(model_named("opencv5"), (160, 100), [114.6, 114.3, 76.4, 54.2, -0.2, 0.05, 1e-4, -1e-4, 0.01])
    rng = np.random.default_rng(1)
    found, _ = observe(small, BOARD, views(small, BOARD, 12, rng=rng), rng=rng, noise_px=0.05)
    detections.write(folder / "seen.csv", Detections(BOARD, found.views))
    picture = rng.integers(0, 255, (100, 160), dtype=np.uint8)
    for side in ("left", "right"):
        cv2.imwrite(str(folder / f"{side}.png"), cv2.GaussianBlur(picture, (0, 0), 2))
    return folder


def test_every_command_that_takes_a_camera_takes_a_part_of_its_images():
    """By its arguments, or as a start; --crop of points is a box in metres."""
    for name, command in REGISTERED.items():
        inputs = (each for each in command.declared if each.positional or each.key == "guess")
        takes = any(re.search(r"CAMERA|RIG\b", each.option.metavar) or each.key == "guess" for each in inputs)
        takes = takes or name in ("convert", "inspect", "plot")
        flags = {spelling for each in command.declared for spelling in each.spellings} & FLAGS
        assert flags == (FLAGS if takes and name not in ITS_OWN else set()), name


@pytest.mark.parametrize(
    "command",
    [
        "inspect CAMERA",
        "inspect CAMERA --at 2m",
        "inspect RIG",
        "plot CAMERA -o FOLDER",
        "plot RIG -o FOLDER",
        "optics CAMERA --pitch-um 3 --f-number 4 --focus 2",
        "check CAMERA seen.csv",
        "pnp CAMERA seen.csv",
        "simulate chessboard:9x6:25mm CAMERA -o FOLDER --views 3 --no-images",
        "calibrate seen.csv -o FOLDER/new.yaml --model opencv5 --guess CAMERA --fix k3",
        "rig seen.csv -o FOLDER/new.yaml --guess CAMERA --lenses prior",
        "stereo rectify RIG left.png right.png -o FOLDER",
        "stereo check left.png right.png RIG",
        "stereo disparity left.png right.png RIG -o FOLDER/d.pfm --max-disparity 32 --force",
    ],
)
def test_a_command_does_with_a_part_what_it_does_with_the_converted_camera(run, folder, tmp_path, monkeypatch, command):
    monkeypatch.chdir(folder)
    documents = []
    for name in ("camera", "rig"):
        assert run("convert", f"{name}.yaml", tmp_path / f"{name}.yaml", *PART)[0] == 0
    for number, (place, part) in enumerate(((folder, PART), (tmp_path, ()))):
        own = tmp_path / str(number)
        own.mkdir()
        words = command.replace("CAMERA", str(place / "camera.yaml")).replace("RIG", str(place / "rig.yaml"))
        code, out, err = run(*words.replace("FOLDER", str(own)).split(), *part, "--json")
        assert out, err
        text = out.replace(str(own), "").replace(str(place), "").replace(str(folder), "")
        documents.append([code, json.loads(text)])
    require_same(*documents)


def require_same(first, second, where=""):
    """Require documents that differ in digits beyond those of a file only, and in where the camera is from."""
    if isinstance(first, dict):
        assert first.keys() - ORIGIN == second.keys() - ORIGIN, where
        for key in first.keys() - ORIGIN:
            require_same(first[key], second[key], f"{where}.{key}")
    elif isinstance(first, list):
        assert len(first) == len(second), where
        for place, (one, other) in enumerate(zip(first, second, strict=True)):
            require_same(one, other, f"{where}[{place}]")
    elif isinstance(first, float):
        assert first == pytest.approx(second, rel=1e-6, abs=1e-9), where
    else:
        assert first == second, where


def test_the_first_of_the_cameras_that_are_compared_is_the_one_of_a_part(run, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    run("convert", "camera.yaml", tmp_path / "part.yaml", *PART)
    code, out, _ = run("diff", "camera.yaml", tmp_path / "part.yaml", *PART, "--max", "1e-9")
    assert code == 0, out


@pytest.mark.parametrize("command", ["plot seen.csv -o FOLDER", "calibrate seen.csv -o FOLDER/a.yaml --model opencv5"])
def test_a_part_of_no_camera_is_refused(run, folder, tmp_path, monkeypatch, command):
    monkeypatch.chdir(folder)
    code, _, err = run(*command.replace("FOLDER", str(tmp_path)).split(), *PART)
    assert code == 2
    assert "--crop, --binning and --scale-to go with " in err


def test_a_crop_keeps_the_noise_of_a_calibration(run, folder, tmp_path):
    run("convert", folder / "camera.yaml", tmp_path / "part.yaml", "--crop", "640x400+60+30")
    assert cameras.read(tmp_path / "part.yaml").cameras["camera"].noise.sigma_px == 0.1


def test_files_of_other_programs_are_shown_and_drawn(run, tmp_path):
    """A size that the file does not say is given; a text file may be of cameras, not of a trajectory."""
    kitti = tmp_path / "calib.txt"
    kitti.write_text("".join(f"P{n}: 700 0 600 {-378 * n} 0 700 180 0 0 0 1 0\n" for n in range(2)))
    code, out, _ = run("inspect", kitti, "--size", "1241x376", "--get", "cameras.cam0.image_size")
    assert (code, json.loads(out)) == (0, [1241, 376])
    code, _, err = run("inspect", kitti)
    assert (code, "has no image size" in err) == (2, True)
    names = ("cameras.txt", "camera.cameramodel", "camera.toml", "camera.json")
    for name in names:
        cameras.write(
            tmp_path / name,
            CameraFile({"camera": CameraEntry(LENS)}),
            cameras.format_for(
                tmp_path / name, "opencv" if name == "camera.json" else None, cameras.FORMATS["opencv"], by_suffix=True
            ),
        )
        assert run("plot", tmp_path / name, "-o", tmp_path / f"{name}.png")[0] == 0, name
