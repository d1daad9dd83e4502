"""Results on standard output, what is said of them beside it, and inputs from standard input."""

import io
import os
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.simulate.scene import observe, views
from camcal.targets.board import parse_board

BOARD = "chessboard:9x6:25mm"
CAMERA = Camera(model_named("pinhole"), (640, 480), np.array([600.0, 600.0, 320.0, 240.0]))
CURVE = "x,y\n0,1\n1,3\n2,5.1\n3,7\n"
POSE = "format: camcal-frames\nversion: 1\ntransforms:\n  a_T_b: {rotation_vector: [0, 0, 0.5], t: [1, 0, 0]}\n"
PATH = "".join(f"{0.1 * k:.1f} {0.01 * k * k:.4f} 0 1 0 0 0 1\n" for k in range(8))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with an input of every kind."""
    folder = tmp_path_factory.mktemp("streams")
    native.write(folder / "camera.yaml", CameraFile({"cam": CameraEntry(CAMERA)}))
    board, rng = parse_board(BOARD), np.random.default_rng(4)
    seen, _ = observe(CAMERA, board, views(CAMERA, board, 12, rng=rng, partial=False), rng=rng)
    detections.write(folder / "corners.csv", seen)
    (folder / "curve.csv").write_text(CURVE)
    (folder / "path.tum").write_text(PATH)
    (folder / "pixels.csv").write_text("u,v\n100,120\n320,240\n")
    (folder / "points.csv").write_text("x,y,z\n1,2,3\n")
    (folder / "pose.yaml").write_text(POSE)
    return folder


@pytest.fixture
def streamed(run, folder, monkeypatch):
    """A function that runs a command line in the folder, a file on standard input if one is named."""

    def call(*words, stdin=None):
        monkeypatch.chdir(folder)
        content = b"" if stdin is None else Path(stdin).read_bytes()
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
        return run(*words)

    return call


COMMANDS = {
    "calibrate": ("calibrate", "corners.csv", "--flat-board"),
    "pnp": ("pnp", "camera.yaml", "corners.csv"),
    "undistort": ("undistort", "camera.yaml", "--points", "pixels.csv"),
    "fit": ("fit", "curve.csv", "--model", "poly:1"),
    "smooth poses": ("smooth", "path.tum", "--frames", "a_T_b", "--q", "1,1", "--sigma", "0.01,0.01"),
    "smooth numbers": ("smooth", "curve.csv"),
    "transform": ("transform", "invert", "pose.yaml"),
    "transform points": ("transform", "points", "points.csv", "--with", "pose.yaml"),
}
SLOW = pytest.param("calibrate", marks=pytest.mark.slow)
SUFFIX = {"calibrate": ".yaml", "pnp": ".yaml", "fit": ".yaml", "transform": ".yaml"}


@pytest.mark.parametrize("name", [SLOW, *(name for name in COMMANDS if name != "calibrate")])
def test_a_result_on_standard_output_is_what_a_file_would_hold(streamed, folder, tmp_path, name):
    output = tmp_path / f"result{SUFFIX.get(name, '.csv')}"
    code, said, warned = streamed(*COMMANDS[name], "-o", output)
    assert code == 0
    code, out, beside = streamed(*COMMANDS[name], "-o", "-")
    assert code == 0
    assert out == output.read_text()
    assert beside.removeprefix(warned).splitlines()[0] == said.splitlines()[0]
    before = sorted(path.name for path in folder.iterdir())
    code, out, err = streamed(*COMMANDS[name], "-o", "-", "--json")
    assert (code, "--json and '-' both write to standard output" in err) == (2, True)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "stdin"),
    [
        pytest.param(("calibrate", "-", "--flat-board", "-o"), "corners.csv", marks=pytest.mark.slow),
        (("pnp", "camera.yaml", "-", "-o"), "corners.csv"),
        (("pnp", "-", "corners.csv", "-o"), "camera.yaml"),
        (("undistort", "-", "--points", "pixels.csv", "-o"), "camera.yaml"),
        (("undistort", "camera.yaml", "--points", "-", "-o"), "pixels.csv"),
        (("fit", "-", "--model", "poly:1", "-o"), "curve.csv"),
        (("smooth", "-", "-o"), "curve.csv"),
        (("transform", "invert", "-", "-o"), "pose.yaml"),
        (("transform", "points", "-", "--with", "pose.yaml", "-o"), "points.csv"),
        (("transform", "points", "points.csv", "--with", "-", "-o"), "pose.yaml"),
    ],
)
def test_standard_input_is_read_as_the_file_is(streamed, words, stdin):
    code, out, err = streamed(*words, "-", stdin=stdin)
    assert (code, "camcal: error" in err) == (0, False), err
    named = [stdin if word == "-" else word for word in words]
    expected = streamed(*named, "-")[1]
    assert out
    assert _without_origin(out) == _without_origin(expected)


def _without_origin(text):
    """Return the lines of a result without what tells where it comes from."""
    skipped = ("command:", "data:", "file:", "  command", "sha256")
    return [line for line in text.splitlines() if not line.strip().startswith(skipped)]


def test_a_camera_file_from_standard_input_is_shown(streamed):
    code, out, _ = streamed("inspect", "-", stdin="camera.yaml")
    assert (code, "pinhole" in out) == (0, True)


@pytest.mark.parametrize("form", ["camcal", "opencv", "ros"])
def test_a_camera_file_is_converted_on_its_way(streamed, tmp_path, form):
    assert streamed("convert", "camera.yaml", tmp_path / "camera.yaml", "--to", form)[0] == 0
    code, out, _ = streamed("convert", "-", "-", "--to", form, stdin="camera.yaml")
    assert code == 0
    assert _without_origin(out) == _without_origin((tmp_path / "camera.yaml").read_text())


def test_commands_join_by_pipes(streamed, folder, tmp_path):
    code, out, _ = streamed("pnp", "camera.yaml", "corners.csv", "-o", "-")
    assert code == 0
    (tmp_path / "piped").write_text(out)
    code, out, err = streamed("transform", "check", "-", stdin=tmp_path / "piped")
    assert (code, err) == (0, "")


def test_nothing_on_standard_input_is_an_error(streamed):
    code, _, err = streamed("fit", "-", "--model", "poly:1")
    assert (code, err) == (3, "camcal: error: -: is empty\n")


def test_a_named_pipe_gets_the_result_and_stays_a_pipe(streamed, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    code, _, _ = streamed("fit", "curve.csv", "--model", "poly:1", "-o", pipe)
    reader.join(10)
    assert code == 0
    assert "format: " in got[0]
    assert pipe.is_fifo()
