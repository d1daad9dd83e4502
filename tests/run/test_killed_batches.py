"""Runs of every command that works on many items, killed at any moment: afterwards every output is absent or whole, and
`--resume` completes to the bytes of a run without interruption.

CAMCAL_KILLS: how many times each command is killed, by default a few.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from room_scene import BESIDE, RoomRig

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import native
from camcal.formats.camera_file import CameraEntry, CameraFile, Transform
from camcal.geometry.pose import Pose
from camcal.images.save import save

KILLS = int(os.environ.get("CAMCAL_KILLS", "3"))
BOARD = "chessboard:6x5:25mm"
TEMPORARY = ".camcal.part-"

# Starts runs as copies of itself, for libraries are then imported once; one after another, from lines of JSON.
SERVER = """
import json, os, signal, sys, time
import cv2, numpy
from camcal.cli import calibrate, poses, raw, rig, stereo, undistort
from camcal.cli.main import app
from camcal.tasks.calibration import calibrate, detect, undistort
from camcal.tasks.stereo import clouds, stereo_disparity, stereo_run, rectify
cv2.setNumThreads(1)
for line in sys.stdin:
    arguments, seconds = json.loads(line)
    began, child = time.monotonic(), os.fork()
    if not child:
        os.setsid()
        log = os.open("run.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        try:
            app(arguments)
        except SystemExit as leaving:
            os._exit(leaving.code or 0)
        os._exit(1)
    if seconds is not None:
        time.sleep(seconds)
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    print(json.dumps([os.waitstatus_to_exitcode(status), time.monotonic() - began]), flush=True)
"""

Run = Callable[..., tuple[int, float]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """What the commands read: images, mosaics, unrectified pairs and their rig, and images of a board."""
    folder = tmp_path_factory.mktemp("scene")
    rng = np.random.default_rng(4)
    for number in range(12):
        save(folder / "images" / f"{number}.png", rng.integers(0, 255, (120, 160), np.uint8))
        save(folder / "mosaics" / f"{number}.pgm", rng.integers(0, 65000, (96, 128)).astype(np.uint16))
    (folder / "rig").mkdir()
    rig = RoomRig(folder / "rig", "pinhole", BESIDE)
    for side in ("left", "right"):
        (folder / side).mkdir()
        for number in range(3):
            shutil.copy(getattr(rig, side), folder / side / f"{number}.png")
    return folder


@pytest.fixture
def run(start_python, scene, monkeypatch):
    """Start a run of camcal in the folder of the scene; it is killed after some seconds, if these are given."""
    monkeypatch.chdir(scene)
    server = start_python("-c", SERVER, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def call(*arguments, kill_after=None):
        server.stdin.write(json.dumps([list(map(str, arguments)), kill_after]) + "\n")
        server.stdin.flush()
        code, seconds = json.loads(server.stdout.readline())
        return code, seconds

    yield call
    server.stdin.close()


def written(path):
    """Write the file of two cameras that see a board together."""
    cameras = [Camera(model_named("opencv4"), (320, 240), [280 + k, 281, 159, 119, -0.1, 0, 0, 0]) for k in range(2)]
    transform = Transform(Pose.from_vector(np.array([0.02, -0.05, 0.01]), np.array([-0.06, 0.002, 0.001])))
    entries = dict(zip(("left", "right"), map(CameraEntry, cameras), strict=True))
    native.write(path, CameraFile(entries, transforms={"right_T_left": transform}))


RIG = "rig/rig.yaml"
COMMANDS = {
    "undistort": ("undistort", f"{RIG}#left", "images", "-o", "out", "--mask"),
    "demosaic": ("demosaic", "mosaics", "-o", "out", "--pattern", "RGGB", "--trust-pattern"),
    "stereo rectify": ("stereo", "rectify", RIG, "left", "right", "-o", "out", "--maps"),
    "stereo disparity": ("stereo", "disparity", "left", "right", RIG, "-o", "out", "--quality", "fast", "--vis"),
    "stereo cloud": ("stereo", "cloud", "left", "right", RIG, "-o", "out", "--quality", "fast"),
    "stereo run": ("stereo", "run", RIG, "left", "right", "-o", "out", "--quality", "fast"),
    "detect": ("detect", "views/images/left", "--board", BOARD, "-o", "out/corners.csv", "--draw", "out/drawn"),
    "calibrate": ("calibrate", "views/images/left", "--board", BOARD, "-o", "out/camera.yaml", "--model", "opencv4"),
    "pnp": ("pnp", "views/truth.yaml#left", "views/images/left", "--board", BOARD, "-o", "out/poses.yaml"),
    "rig": ("rig", "views/images", "--recursive", "--board", BOARD, "-o", "out/rig.yaml", "--model", "opencv4"),
}


def contents(folder=Path("out")):
    """The files of a folder and of those below it, by their paths."""
    return {path.as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def killed_and_resumed(run, arguments, kills):
    """Kill runs at random moments and resume them; return how many of them were really killed."""
    shutil.rmtree("out", ignore_errors=True)
    code, seconds = run(*arguments, "--jobs", 1, "--resume")
    assert code == 0, Path("run.log").read_text()
    whole = contents()
    rng = np.random.default_rng(7)
    killed = 0
    for share in rng.uniform(0.02, 1.0, kills):
        shutil.rmtree("out", ignore_errors=True)
        code, _ = run(*arguments, "--jobs", 1, kill_after=share * seconds)
        killed += code < 0
        left = {path: content for path, content in contents().items() if not Path(path).name.startswith(".")}
        assert {path: whole[path] for path in left} == left
        assert run(*arguments, "--jobs", 1, "--resume")[0] == 0, Path("run.log").read_text()
        assert contents() == whole
    return killed


def test_undistort_killed_at_any_moment_is_completed_to_the_same_bytes(run):
    assert killed_and_resumed(run, COMMANDS["undistort"], 2) > 0
    before = {path: Path(path).stat().st_mtime_ns for path in contents()}
    assert run(*COMMANDS["undistort"], "--resume")[0] == 0
    assert {path: Path(path).stat().st_mtime_ns for path in contents()} == before
    assert "nothing to do: 12 images complete and unchanged" in Path("run.log").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_killed_at_any_moment_is_completed_to_the_same_bytes(run, command):
    if BOARD in COMMANDS[command] and not Path("views").exists():
        written(Path("cameras.yaml"))
        assert run("simulate", BOARD, "cameras.yaml", "-o", "views", "--views", 8, "--jobs", 1)[0] == 0
    assert killed_and_resumed(run, COMMANDS[command], KILLS) > 0
    before = {path: Path(path).stat().st_mtime_ns for path in contents()}
    assert run(*COMMANDS[command], "--resume")[0] == 0
    assert {path: Path(path).stat().st_mtime_ns for path in contents()} == before
    assert "nothing to do" in Path("run.log").read_text()
