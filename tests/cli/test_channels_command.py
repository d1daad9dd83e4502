"""Raw frames on the command line: detected, calibrated colour by colour, and undistorted so that the colours coincide.

One set of eight small frames serves all tests; what accuracy is reached is tested in tests/calibrate and tests/tasks.
"""

import json

import numpy as np
import pytest

from camcal.formats import native
from camcal.images.files import load, save
from camcal.raw.demosaic import demosaic
from camcal.tasks.simulation.options import RawOptions, SimulateOptions
from camcal.tasks.simulation.simulate import simulate

BOARD = "chessboard:8x5:30mm"
SIZE = (480, 360)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A folder with images/ of raw frames with 1 px of aberration, and one of them developed to colour."""
    folder = tmp_path_factory.mktemp("raw") / "scene"
    raw = RawOptions("RGGB", light=(0.5, 1.0, 0.6), aberration_px=1.0)
    report = simulate(SimulateOptions(folder, BOARD, size=SIZE, views=8, jobs=1, raw=raw))
    colour = demosaic(load(report.images[0]).pixels, "RGGB", "bilinear", white=4095)
    save(folder / "colour.png", colour)
    return folder


def calibrated(run, scene, *options):
    words = ("--board", BOARD, "--pattern", "RGGB", "--model", "opencv5", "--jobs", 1, *options)
    return run("calibrate", scene / "images", *words)


@pytest.mark.slow
def test_channels_are_written_to_the_camera_file_and_reported(run, scene, tmp_path):
    output = tmp_path / "camera.yaml"
    code, out, err = calibrated(run, scene, "--channels", "-o", output, "--json")
    assert (code, "channel" in err) == (0, False)
    told = json.loads(out)["channels"]
    assert list(told) == ["red", "blue"]
    assert list(told["red"]) == ["parameters", "std", "aberration"]
    assert list(told["red"]["aberration"]) == [
        "corner_px", "corner_std_px", "largest_px", "largest_std_px", "largest_at", "terms", "sigma_px", "points_used",
        "points_rejected",
    ]  # fmt: skip
    for colour, sign in (("red", 1), ("blue", -1)):
        found = told[colour]["aberration"]
        assert found["corner_px"] == pytest.approx(sign, abs=5 * found["corner_std_px"])
        assert found["corner_std_px"] < 0.02
    file = native.read(output)
    entry = file.cameras["camera"]
    assert list(entry.channels) == ["red", "blue"]
    assert entry.channels["red"].value("fx") > entry.camera.value("fx") > entry.channels["blue"].value("fx")
    written = file.provenance["aberration"]["red"]
    assert list(written) == list(told["red"]["aberration"])
    assert written["corner_px"] == pytest.approx(told["red"]["aberration"]["corner_px"])
    assert "--pattern RGGB --channels" in file.provenance["command"]


@pytest.mark.slow
def test_the_aberration_stands_in_a_table(run, scene, tmp_path):
    code, out, _ = calibrated(run, scene, "--channels", "-o", tmp_path / "camera.yaml")
    assert code == 0
    start = out.index("lateral chromatic aberration against green, px")
    lines = out[start:].splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["colour", "red", "blue"]
    assert float(lines[2].split()[1]) == pytest.approx(1, abs=0.05)


@pytest.mark.slow
def test_without_channels_nothing_is_said_of_them(run, scene, tmp_path):
    output = tmp_path / "camera.yaml"
    code, out, _ = calibrated(run, scene, "-o", output, "--json")
    assert code == 0
    assert "channels" not in json.loads(out)
    assert native.read(output).cameras["camera"].channels == {}


def test_the_corners_of_raw_frames_are_written(run, scene, tmp_path):
    output = tmp_path / "corners.csv"
    for algorithm in ("green", "gray"):
        options = ["--pattern", "RGGB", "--algorithm", algorithm, "--jobs", 1]
        code, out, _ = run("detect", scene / "images" / "view0000.png", "-b", BOARD, "-o", output, *options)
        assert code == 0
        assert "1 of 1 image with the board" in out


def test_a_table_of_corners_has_no_channels(run, scene, tmp_path):
    code, _, err = run("calibrate", scene / "corners.csv", "--channels", "-o", tmp_path / "camera.yaml")
    assert code == 2
    assert "--channels applies to images, not to a detections file" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--algorithm", "ri"], "'ri' is not one of green, gray"),
        (["--algorithm", "gray", "--channels"], "leave --algorithm out"),
    ],
)
def test_a_wrong_option_is_one_line_and_exit_two(run, scene, tmp_path, options, words):
    code, _, err = calibrated(run, scene, *options, "-o", tmp_path / "camera.yaml")
    assert (code, err.count("\n")) == (2, 1)
    assert words in err


def test_undistorted_colours_coincide_unless_told_otherwise(run, scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    truth = scene / "truth.yaml"
    code, out, _ = run("undistort", truth, scene / "colour.png", "-o", "aligned", "--jobs", 1)
    assert code == 0
    assert "red and blue of colour images undistorted with their own lens models" in out
    assert run("undistort", truth, scene / "colour.png", "-o", "apart", "--no-align-channels", "--jobs", 1)[0] == 0
    fringes = {}
    for name in ("aligned", "apart"):
        blue, _, red = np.moveaxis(load(tmp_path / name / "colour.png").pixels.astype(float), -1, 0)
        fringes[name] = np.abs(red / np.median(red) - blue / np.median(blue)).mean()
    assert fringes["aligned"] < 0.8 * fringes["apart"]
    aligned, apart = (native.read(tmp_path / name / "camera.yaml").provenance for name in ("aligned", "apart"))
    assert aligned["aligned_channels"] == ["red", "blue"]
    assert "aligned_channels" not in apart
    assert "--no-align-channels" in apart["command"]


def test_channels_are_resized_with_their_camera(run, scene, tmp_path):
    small = load(scene / "colour.png").pixels[::2, ::2]
    save(tmp_path / "small.png", small)
    output = tmp_path / "out"
    options = ["--scale-intrinsics", "--jobs", 1, "--json"]
    code, out, _ = run("undistort", scene / "truth.yaml", tmp_path / "small.png", "-o", output, *options)
    assert code == 0
    assert json.loads(out)["aligned_channels"] == ["red", "blue"]
    assert load(output / "small.png").size == (SIZE[0] // 2, SIZE[1] // 2)
