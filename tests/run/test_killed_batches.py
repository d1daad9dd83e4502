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
from batch_scenes import BOARD, COMMANDS, SIMULATION, contents, draw_scene

KILLS = int(os.environ.get("CAMCAL_KILLS", "3"))

# Starts runs as copies of itself, for libraries are then imported once; one after another, from lines of JSON.
SERVER = """
import importlib, json, os, signal, sys, time
import cv2, numpy
from camcal.cli.main import app
for module in sys.argv[1:]:
    importlib.import_module(f"camcal.{module}")
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

UNDISTORT = ("cli.calibrate", "tasks.calibration.undistort")
OTHERS = (
    *("cli.poses", "cli.raw", "cli.calibrate", "cli.stereo", "tasks.calibration.calibrate"),
    *("tasks.calibration.detect", "tasks.stereo.clouds", "tasks.stereo.stereo_disparity", "tasks.stereo.stereo_run"),
    "tasks.stereo.rectify",
)

Run = Callable[..., tuple[int, float]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """What the commands read: images, mosaics, unrectified pairs and their rig, and images of a board."""
    folder = tmp_path_factory.mktemp("scene")
    draw_scene(folder)
    return folder


@pytest.fixture
def run(request, start_python, scene, monkeypatch):
    """Start a run of camcal in the folder of the scene; it is killed after some seconds, if these are given."""
    monkeypatch.chdir(scene)
    modules = (*UNDISTORT, *OTHERS) if request.node.get_closest_marker("slow") else UNDISTORT
    server = start_python("-c", SERVER, *modules, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def call(*arguments, kill_after=None):
        server.stdin.write(json.dumps([list(map(str, arguments)), kill_after]) + "\n")
        server.stdin.flush()
        code, seconds = json.loads(server.stdout.readline())
        return code, seconds

    yield call
    server.stdin.close()


def modified():
    """When each file of the output was changed."""
    return {path: Path("out", path).stat().st_mtime_ns for path in contents()}


def kill_and_resume(run, arguments, kills):
    """Kill as many runs, each at a random moment of its own part of the time that a run takes, and resume them.

    The time is that of the fastest run so far, and runs that ended before they were killed do not count: the first run
    can be slower than all that follow.
    """
    shutil.rmtree("out", ignore_errors=True)
    code, seconds = run(*arguments, "--jobs", 1, "--resume")
    assert code == 0, Path("run.log").read_text()
    whole = contents()
    rng = np.random.default_rng(7)
    killed = 0
    while killed < kills:
        shutil.rmtree("out", ignore_errors=True)
        moment = max((killed + rng.uniform()) / kills, 0.02) * seconds
        code, taken = run(*arguments, "--jobs", 1, kill_after=moment)
        assert code <= 0, Path("run.log").read_text()
        killed += code < 0
        seconds = seconds if code < 0 else min(seconds, taken)
        left = {path: content for path, content in contents().items() if not Path(path).name.startswith(".")}
        assert {path: whole[path] for path in left} == left
        assert run(*arguments, "--jobs", 1, "--resume")[0] == 0, Path("run.log").read_text()
        assert contents() == whole


def test_undistort_killed_at_any_moment_is_completed_to_the_same_bytes(run):
    kill_and_resume(run, COMMANDS["undistort"], 2)
    before = modified()
    assert run(*COMMANDS["undistort"], "--resume")[0] == 0
    assert modified() == before
    assert "nothing to do: 12 images complete and unchanged" in Path("run.log").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_killed_at_any_moment_is_completed_to_the_same_bytes(run, command):
    if BOARD in COMMANDS[command] and not Path("views").exists():
        assert run(*SIMULATION)[0] == 0
    kill_and_resume(run, COMMANDS[command], KILLS)
    before = modified()
    assert run(*COMMANDS[command], "--resume")[0] == 0
    assert modified() == before
    assert "nothing to do" in Path("run.log").read_text()
