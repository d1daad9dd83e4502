"""Runs of every command that works on many items, killed at any moment: afterwards every output is absent or whole, and
`--resume` completes to the bytes of a run without interruption.

CAMCAL_KILLS: how many times each command is killed, by default once, each at another part of its time.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from batch_scenes import BOARD, COMMANDS, SIMULATION, contents, draw_scene

KILLS = int(os.environ.get("CAMCAL_KILLS", "1"))

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

MODULES = (
    *("cli.poses", "cli.calibrate", "cli.images", "cli.stereo", "tasks.calibration.calibrate"),
    *("tasks.calibration.detect", "tasks.stereo.clouds", "tasks.stereo.stereo_disparity", "tasks.stereo.stereo_run"),
    *("tasks.stereo.rectify", "tasks.calibration.undistort"),
)

Run = Callable[..., tuple[int, float]]


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """What the commands read: images, mosaics, unrectified pairs and their rig, and images of a board."""
    folder = tmp_path_factory.mktemp("scene")
    draw_scene(folder)
    return folder


@pytest.fixture(scope="module")
def server(scene):
    """The process that starts runs in the folder of the scene; it ends with what it started."""
    command = [sys.executable, "-c", SERVER, *MODULES]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=scene, text=True, start_new_session=True, **pipes) as process:
        yield process
        process.stdin.close()


@pytest.fixture
def run(server, scene, monkeypatch):
    """Start a run of camcal in the folder of the scene; it is killed after some seconds, if these are given."""
    monkeypatch.chdir(scene)

    def call(*arguments, kill_after=None):
        server.stdin.write(json.dumps([list(map(str, arguments)), kill_after]) + "\n")
        server.stdin.flush()
        code, seconds = json.loads(server.stdout.readline())
        return code, seconds

    return call


def modified():
    """When each file of the output was changed."""
    return {path: Path("out", path).stat().st_mtime_ns for path in contents()}


def kill_and_resume(run, arguments, kills, seed):
    """Kill as many runs, each at a random moment of its own part of the time that a run takes, and resume them.

    The time is that of the fastest run so far, and runs that ended before they were killed do not count: the first run
    can be slower than all that follow.
    """
    shutil.rmtree("out", ignore_errors=True)
    code, seconds = run(*arguments, "--jobs", 1, "--resume")
    assert code == 0, Path("run.log").read_text()
    whole = contents()
    rng = np.random.default_rng(seed)
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


@pytest.mark.parametrize(
    "command", [name if name == "undistort" else pytest.param(name, marks=pytest.mark.slow) for name in COMMANDS]
)
def test_a_command_killed_at_any_moment_is_completed_to_the_same_bytes(run, command):
    if BOARD in COMMANDS[command] and not Path("views").exists():
        assert run(*SIMULATION)[0] == 0
    kill_and_resume(run, COMMANDS[command], KILLS, list(COMMANDS).index(command))
    before = modified()
    assert run(*COMMANDS[command], "--resume")[0] == 0
    assert modified() == before
    assert "nothing to do" in Path("run.log").read_text()
