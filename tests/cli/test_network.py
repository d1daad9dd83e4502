"""Commands open no network connection unless a URL is given: what Python does is watched in every process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from batch_scenes import BOARD, COMMANDS, SIMULATION, draw_scene

HOOK = """
import os, sys
NETWORK = {"socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"}
def watch(event, arguments):
    local = bool(arguments) and isinstance(arguments[-1], (str, bytes))  # a socket of this machine has a path
    if event in NETWORK and not local:
        with open(os.environ["SEEN"], "a", encoding="utf-8") as seen:
            print(event, *arguments[1:], file=seen)
sys.addaudithook(watch)
"""
CAMCAL = """
import json, sys
from camcal.cli.main import app
for call in json.loads(sys.argv[1]):
    try:
        app(call)
    except SystemExit as leaving:
        if leaving.code:
            raise
"""
PIPELINE = """\
steps:
  straight: {command: undistort, arguments: [rig/rig.yaml#left, images], output: straight}
"""
CALLS = (
    SIMULATION,
    *((*words, "--jobs", 1) for words in COMMANDS.values()),
    (*COMMANDS["detect"], "--timeout", 60, "--jobs", 2),
    (*COMMANDS["detect"], "--resume"),
    ("calibrate", "out/corners.csv", "-b", BOARD, "-o", "camera.yaml", "--report", "report.html"),
    ("stereo", "check", "left", "right"),
    ("run", "pipeline.yaml"),
    ("doctor",),
)


@pytest.fixture
def watched(tmp_path):
    """A function that runs Python in a folder and gives what it asked of the network."""
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook" / "sitecustomize.py").write_text(HOOK)
    seen = tmp_path / "seen.txt"
    paths = os.pathsep.join([str(tmp_path / "hook"), str(Path(__file__).parents[2])])
    environment = os.environ | {"PYTHONPATH": paths, "SEEN": str(seen)}

    def run(*words):
        seen.write_text("")
        done = subprocess.run(
            [sys.executable, "-c", *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert "Traceback" not in done.stderr
        return done.returncode, seen.read_text().splitlines()

    return run


def test_what_is_watched_would_be_seen(watched):
    call = "import socket, contextlib\nwith contextlib.suppress(OSError): socket.create_connection(('127.0.0.1', 9), 1)"
    assert any(line.startswith("socket.connect") for line in watched(call)[1])


@pytest.mark.slow
def test_commands_open_no_connection(watched, tmp_path):
    draw_scene(tmp_path)
    (tmp_path / "pipeline.yaml").write_text(PIPELINE)
    calls = [list(map(str, words)) for words in CALLS]
    assert watched(CAMCAL, json.dumps(calls)) == (0, [])
