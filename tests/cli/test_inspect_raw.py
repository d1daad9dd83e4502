"""`camcal inspect` of raw frames as it is called from a shell."""

import json

import cv2
import numpy as np
import pytest

from camcal.raw.dng import write_dng
from camcal.raw.mosaic import Capture, Mosaic

CAPTURE = Capture("Acme", "Model 1", 1 / 250, 400, 2.8, 50)


def counts():
    values = np.full((40, 60), 1064, np.uint16)
    values[::2, ::2] = 4095  # red is clipped
    values[1::2, 1::2] = 64  # blue sees nothing
    return values


@pytest.fixture
def dng(tmp_path):
    black = np.array([[64.0, 65.0], [66.0, 67.0]])
    frame = Mosaic(counts(), "RGGB", black, 4095.0, np.array([2.25, 1, 1.5]), None, 6, CAPTURE)
    write_dng(tmp_path / "frame.dng", frame)
    return tmp_path / "frame.dng"


def test_a_person_reads_levels_clipping_balance_and_capture(run, dng, monkeypatch):
    assert "histogram" not in run("inspect", dng)[1]  # in a pipe
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "1000")  # paths are not wrapped
    code, out, err = run("inspect", dng)
    assert (code, err) == (0, "")
    for words in (
        f"{dng}: 60x40, RGGB, uint16",
        "Acme Model 1, 1/250 s, f/2.8, ISO 400, 50 mm",
        "black 64 65 66 67, white 4095",
        "white balance of the camera R 2.25, G 1, B 1.5",
        "EXIF orientation 6",
        "R        4095.00   4095  4095           0         100",
        "B          64.00     64    64         100           0",
        "histogram, 64 bins from 0 to 4095",
    ):
        assert words in out
    bars = {line.split()[0]: line.split("|")[1] for line in out.splitlines() if line.endswith("|")}
    assert list(bars) == ["R", "Gr", "Gb", "B"]
    assert {len(line) for line in bars.values()} == {64}
    assert [line.index("█") for line in bars.values()] == [63, 16, 16, 1]  # 64 · counts / 4095, rounded down


def test_json_has_the_frame_and_its_channels(run, dng):
    code, out, _ = run("inspect", dng, "--json")
    document = json.loads(out)
    raw = document["raw"]
    assert code == 0
    assert list(document) == ["schema", "file", "raw", "warnings"]
    assert document["schema"] == "camcal/inspect/1"
    assert list(raw) == [
        *("size", "pattern", "type", "black", "white", "camera_gains", "camera_M_xyz", "orientation", "capture"),
        "channels",
    ]
    assert (raw["size"], raw["pattern"], raw["black"], raw["white"]) == ([60, 40], "RGGB", [[64, 65], [66, 67]], 4095)
    assert raw["capture"] == vars(CAPTURE)
    assert [channel["name"] for channel in raw["channels"]] == ["R", "Gr", "Gb", "B"]
    assert list(raw["channels"][0]) == [
        *("name", "samples", "mean", "least", "most", "at_black", "at_white", "histogram"),
    ]
    assert raw["channels"][0]["at_white"] == 1
    assert raw["channels"][1]["histogram"][16] == 600


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm", ".npy"])
def test_a_bare_mosaic_is_shown_with_its_pattern(run, tmp_path, suffix):
    path = tmp_path / f"bare{suffix}"
    np.save(path, counts()) if suffix == ".npy" else cv2.imwrite(str(path), counts())
    code, out, _ = run("inspect", path, "--pattern", "BGGR")
    assert code == 0
    assert "60x40, BGGR, uint16\nblack 0, white 65535" in out
    assert run("inspect", path)[0] == 2


@pytest.fixture
def dump(tmp_path):
    """A header-less file of a common size, 12 bits in 16."""
    values = np.full((480, 640), 1000, "<u2")
    values[::2, ::2] = 4095
    (tmp_path / "dump.raw").write_bytes(values.tobytes())
    return tmp_path / "dump.raw"


def test_a_file_without_a_header_is_shown_by_what_fits_its_length(run, dump):
    code, out, err = run("inspect", dump)
    assert (code, err) == (0, "")
    assert f"{dump}: 614400 bytes without a header; these fit, give --format and --size" in out
    assert any("640x480" in line and "Bayer12" in line for line in out.splitlines())
    document = json.loads(run("inspect", dump, "--json", "--format", "BayerRG12")[1])
    assert list(document) == ["schema", "file", "bytes", "layouts", "warnings"]
    assert {"formats": ["BayerRG12"], "size": [640, 480], "stride": None} in document["layouts"]


def test_a_length_that_nothing_has_is_said(run, tmp_path):
    (tmp_path / "odd.bin").write_bytes(bytes(12347))
    assert "12347 bytes without a header; no common format and size fits" in run("inspect", tmp_path / "odd.bin")[1]


def test_a_file_without_a_header_is_read_by_its_layout(run, dump):
    code, out, _ = run("inspect", dump, "--format", "BayerRG12", "--size", "640x480")
    assert code == 0
    assert "640x480, RGGB, uint16\nblack 0, white 4095" in out
    assert "R        4095.00   4095  4095           0         100" in out


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--format", "BayerRG13"], 2, "BayerRG13"),
        (["--format", "Bayer12", "--size", "640x480"], 2, "--pattern"),
        (["--format", "BayerRG12", "--size", "640x481"], 3, "needs 615680 bytes"),
        (["--size", "640"], 2, "not a size"),
    ],
)
def test_a_layout_that_does_not_fit_gets_one_line(run, dump, options, code, words):
    ended, out, err = run("inspect", dump, *options)
    assert (ended, out) == (code, "")
    assert words in err
    assert len(err.splitlines()) == 1


def test_a_missing_file_without_a_header_is_a_file_error(run, tmp_path):
    assert run("inspect", tmp_path / "missing.raw")[0] == 3


def test_quiet_says_nothing_but_errors(run, dng, tmp_path):
    assert run("inspect", dng, "--quiet") == (0, "", "")
    assert run("inspect", tmp_path / "missing.dng", "--quiet")[0] == 3


@pytest.mark.parametrize("option", [("--get", "white"), ("--camera", "left")])
def test_options_of_camera_files_are_refused_for_raw_frames(run, dng, option):
    code, out, err = run("inspect", dng, *option)
    assert (code, out) == (2, "")
    assert "use --json" in err


def test_a_file_that_is_cut_off_gets_one_line(run, dng, tmp_path):
    short = tmp_path / "short.dng"
    short.write_bytes(dng.read_bytes()[:-100])
    code, out, err = run("inspect", short)
    assert (code, out) == (3, "")
    assert "short.dng: truncated" in err
    assert len(err.splitlines()) == 1


def test_a_camera_file_without_white_balance_is_said(run, tmp_path):
    write_dng(tmp_path / "bare.dng", Mosaic(counts(), "RGGB", np.full((2, 2), 64.0), 4095.0))
    write_dng(tmp_path / "mono.dng", Mosaic(counts(), "MONO", np.full((2, 2), 64.0), 4095.0))
    assert "no white balance of the camera in the file: --wb gray-world" in run("inspect", tmp_path / "bare.dng")[1]
    assert "white balance" not in run("inspect", tmp_path / "mono.dng")[1]
