"""`camcal simulate --raw` as it is called from a shell: mosaics, flat and dark frames, the sensor in the truth."""

import json

import numpy as np
import pytest

from camcal.formats import native
from camcal.images.files import load

BOARD = "chessboard:7x5:25mm"
SMALL = ("--size", "160x120", "--views", "2", "--jobs", "1", "--quiet")
SENSOR = ("--gain", "0.5", "--read-noise", "3", "--full-well", "7000", "--black", "32", "--bits", "12")


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "simulated"


def frames_of(folder):
    return sorted(
        path.relative_to(folder).as_posix() for kind in ("flats", "darks") for path in folder.glob(f"{kind}/*/*")
    )


def test_mosaics_frames_and_truth_are_written(run, folder):
    options = ("--raw", "GRBG", *SENSOR, "--light", ".5,1,.6", "--flats", "2", "--darks", "3")
    assert run("simulate", BOARD, "-o", folder, *SMALL, *options) == (0, "", "")
    frame = load(folder / "images" / "view0000.png").pixels
    assert (frame.shape, frame.dtype) == ((120, 160), np.uint16)
    assert 32 + 0.25 * 3500 < frame.max() <= 4095
    assert frames_of(folder) == [
        "darks/30ms/dark0000.png",
        "darks/30ms/dark0001.png",
        "darks/30ms/dark0002.png",
        "flats/30ms/flat0000.png",
        "flats/30ms/flat0001.png",
        "flats/60ms/flat0002.png",
        "flats/60ms/flat0003.png",
    ]
    truth = native.read(folder / "truth.yaml")
    assert truth.cameras["camera"].sensor == {
        "gain_e_per_dn": 2.0,
        "read_noise_e": 3.0,
        "full_well_e": 7000.0,
        "black_level_dn": 32.0,
        "bits": 12,
    }
    assert truth.extra["x_simulation"]["raw"]["light_rgb"] == [0.5, 1.0, 0.6]
    assert truth.cameras["camera"].channels == {}


def test_aberration_is_in_the_truth_as_lenses_of_red_and_blue(run, folder):
    assert run("simulate", BOARD, "-o", folder, *SMALL, "--raw", "RGGB", "--aberration", "0.5")[0] == 0
    entry = native.read(folder / "truth.yaml").cameras["camera"]
    assert list(entry.channels) == ["red", "blue"]
    assert entry.channels["red"].value("fx") > entry.camera.value("fx") > entry.channels["blue"].value("fx")


def test_the_same_options_give_the_same_bytes_and_frames_differ(run, tmp_path):
    options = (*SMALL, "--raw", "RGGB", "--flats", "1", "--darks", "4", "--prnu", "1", "--dsnu", "2")
    for name in ("one", "two"):  # that --jobs changes nothing is seen of images in test_simulate.py
        run("simulate", BOARD, "-o", tmp_path / name, *options)
    one, two = (
        {path.relative_to(tmp_path / name): path.read_bytes() for path in (tmp_path / name).rglob("*.png")}
        for name in ("one", "two")
    )
    assert one == two
    assert len(set(one.values())) == len(one) == 8


def test_a_second_run_replaces_the_frames_of_the_first(run, folder):
    run("simulate", BOARD, "-o", folder, *SMALL, "--raw", "RGGB", "--flats", "2", "--darks", "2")
    run("simulate", BOARD, "-o", folder, *SMALL, "--raw", "RGGB", "--flats", "1")
    assert frames_of(folder) == ["flats/60ms/flat0000.png", "flats/60ms/flat0001.png"]
    run("simulate", BOARD, "-o", folder, *SMALL)
    assert not (folder / "flats").exists()


def test_json_lists_the_frames(run, folder):
    _, out, _ = run("simulate", BOARD, "-o", folder, *SMALL, "--raw", "RGGB", "--flats", "1", "--darks", "2", "--json")
    document = json.loads(out)
    assert list(document)[-2:] == ["frames", "warnings"]
    assert len(document["frames"]) == 4


def test_a_person_reads_what_to_do_next(run, folder):
    raw = ("--raw", "RGGB", "--flats", "1", "--darks", "2")
    _, out, _ = run("simulate", BOARD, "-o", folder, *SMALL[:-1], *raw)
    assert "4 flat and dark frames" in out
    assert f"next: camcal sensor {folder}/flats --dark {folder}/darks --pattern RGGB" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--gain", "1"], "need --raw"),
        (["--flats", "3"], "need --raw"),
        (["--aberration", "1"], "need --raw"),
        (["--raw", "RGBG"], "pattern 'RGBG' is unknown"),
        (["--raw", "RGGB", "--noise", "2"], "--raw excludes --noise, --gamma and --depth"),
        (["--raw", "RGGB", "--gamma", "2.2"], "--raw excludes --noise, --gamma and --depth"),
        (["--raw", "RGGB", "--bits", "20"], "20 bits"),
        (["--raw", "RGGB", "--light", "1,1"], "is not three numbers"),
        (["--raw", "RGGB", "--light", "1,-1,1"], "must be positive"),
        (["--raw", "MONO", "--aberration", "1"], "without colour filters"),
        (["--raw", "RGGB", "--aberration", "nan"], "px folds the image"),
        (["--raw", "RGGB", "--flats", "1000"], "1000 levels"),
        (["--vignetting", "120"], "vignetting"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_nothing_is_written(run, folder, arguments, message):
    code, out, err = run("simulate", BOARD, "-o", folder, *SMALL, *arguments)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not folder.exists()
