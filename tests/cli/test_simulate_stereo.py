"""`camcal simulate --stereo` as it is called from a shell: what it writes, refuses and repeats."""

import json
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from camcal.cli.main import app
from camcal.formats import disparity, disparity_sidecar, native
from camcal.images.files import load
from camcal.stereo.disparity import of_pair

SMALL = ("--stereo", "--size", "96x72", "--objects", "2", "--jobs", "1", "--quiet")
BOARD = "chessboard:7x5:25mm"


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "simulated"


@pytest.fixture(scope="module")
def two_pairs(tmp_path_factory):
    """A folder of two pairs; nothing may be written into it."""
    folder = tmp_path_factory.mktemp("simulated") / "two"
    with pytest.raises(SystemExit) as leaving:
        app(["simulate", "-o", str(folder), *SMALL, "--pairs", "2"])
    assert leaving.value.code == 0
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_pairs_and_their_truth_are_written(two_pairs):
    assert sorted(contents(two_pairs)) == [
        "disparity/000.pfm",
        "disparity/000.pfm.json",
        "disparity/001.pfm",
        "disparity/001.pfm.json",
        "disparity_right/000.pfm",
        "disparity_right/000.pfm.json",
        "disparity_right/001.pfm",
        "disparity_right/001.pfm.json",
        "left/000.png",
        "left/001.png",
        "rig.yaml",
        "right/000.png",
        "right/001.png",
        "visible/000.png",
        "visible/001.png",
    ]
    assert load(two_pairs / "left" / "001.png").pixels.shape == (72, 96, 3)
    assert set(np.unique(load(two_pairs / "visible" / "000.png").pixels)) == {0, 255}


def test_the_rig_and_the_sidecars_say_the_same(run, folder):
    run("simulate", "-o", folder, *SMALL, "--fov", "70", "--baseline", "0.2", "--doffs", "4.5")
    rig = native.read(folder / "rig.yaml")
    cameras = [rig.cameras[name].camera for name in ("left", "right")]
    geometry = of_pair(*cameras, rig.transforms["right_T_left"].pose)
    known = disparity_sidecar.read(folder / "disparity" / "000.pfm")
    assert known.geometry == pytest.approx(geometry)
    assert (geometry.baseline, geometry.doffs) == pytest.approx((0.2, 4.5), rel=1e-11)  # 12 digits in the file
    assert geometry.fx == pytest.approx(48 / np.tan(np.radians(35)), rel=1e-11)
    assert known.image.resolve() == (folder / "left" / "000.png").resolve()
    right = disparity_sidecar.read(folder / "disparity_right" / "000.pfm")
    assert right.geometry.cx == pytest.approx(geometry.cx + 4.5)


def test_disparities_lie_where_they_are_asked_for(run, folder):
    run("simulate", "-o", folder, *SMALL, "--disparities", "5:20")
    values = disparity.read(folder / "disparity" / "000.pfm").values
    assert values.min() >= 5
    assert values.max() <= 20


def test_distances_stand_for_disparities(run, folder):
    run("simulate", "-o", folder, *SMALL, "--distance", "1:3", "--baseline", "0.15")
    known = disparity_sidecar.read(folder / "disparity" / "000.pfm").geometry
    depths = known.fx * known.baseline / disparity.read(folder / "disparity" / "000.pfm").values
    assert depths.min() >= 1 - 1e-6  # float32
    assert depths.max() <= 3 + 1e-6


def test_gray_16_bit_images_are_made(run, folder):
    run("simulate", "-o", folder, *SMALL, "--gray", "--depth", "16")
    pixels = load(folder / "right" / "000.png").pixels
    assert (pixels.shape, pixels.dtype) == ((72, 96), np.uint16)


def test_the_right_image_gets_its_exposure_and_its_vertical_error(run, tmp_path):
    errors = ("--right-gain", "0.5", "--right-offset", "3", "--right-gamma", "1.2", "--row-shift", "1")
    run("simulate", "-o", tmp_path / "good", *SMALL, "--noise", "0", "--depth", "16")
    run("simulate", "-o", tmp_path / "bad", *SMALL, "--noise", "0", "--depth", "16", *errors)
    (left, other_left), (good, bad) = (
        [load(tmp_path / name / eye / "000.png").pixels / 65535 for name in ("good", "bad")]
        for eye in ("left", "right")
    )
    assert np.array_equal(left, other_left)
    assert bad[1:] == pytest.approx(0.5 * good[:-1] ** 1.2 + 3 / 255, abs=2 / 65535)  # counts of 16 bits


@pytest.mark.slow
def test_the_same_options_give_the_same_bytes_whatever_the_jobs(run, two_pairs, tmp_path):
    assert run("simulate", "-o", tmp_path / "again", *SMALL, "--pairs", "2", "--jobs", "2") == (0, "", "")
    run("simulate", "-o", tmp_path / "other", *SMALL, "--seed", "1")
    one, again, other = (contents(folder) for folder in (two_pairs, tmp_path / "again", tmp_path / "other"))
    assert one == again
    assert one["left/000.png"] != one["left/001.png"]
    assert one["left/000.png"] != other["left/000.png"]


def test_a_second_run_replaces_its_own_pairs(run, two_pairs, folder):
    copytree(two_pairs, folder)
    assert run("simulate", "-o", folder, *SMALL)[0] == 0
    assert len(contents(folder)) == 8


@pytest.mark.parametrize("arguments", [(BOARD, "--views", "1", "--size", "160x120", "--quiet"), SMALL])
def test_a_folder_of_something_else_is_left_alone(run, folder, arguments):
    folder.mkdir()
    (folder / "rig.yaml").write_text("mine")
    code, _, err = run("simulate", *arguments, "-o", folder)
    assert code == 2
    assert "choose another folder" in err
    assert contents(folder) == {"rig.yaml": b"mine"}


def test_json_is_one_document_with_a_frozen_schema(run, folder):
    code, out, err = run("simulate", "-o", folder, *SMALL, "--json")
    document = json.loads(out)
    assert (code, err) == (0, "")
    assert list(document) == ["schema", "output", "rig", "image_size", "geometry", "pairs", "warnings"]
    assert document["schema"] == "camcal/simulate/1"
    assert list(document["pairs"][0]) == [
        "left",
        "right",
        "disparity",
        "disparity_right",
        "visible",
        "least",
        "greatest",
        "shared",
    ]


def test_a_person_reads_what_to_do_next(run, folder):
    code, out, _ = run("simulate", "-o", folder, *SMALL[:-1], "--verbose")
    assert code == 0
    assert "1 pair of 96x72" in out
    assert "next: camcal stereo disparity" in out
    assert "seen by both" in out


def test_options_come_from_a_settings_file_too(run, folder, tmp_path):
    settings = tmp_path / "simulate.yaml"
    settings.write_text("stereo: true\nsize: 96x72\nobjects: 3\nviews: 5\n")
    code, _, err = run("simulate", "-o", folder, "--config", settings)
    assert code == 2
    assert "--views cannot be used with --stereo" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--stereo", BOARD], "BOARD cannot be used with --stereo"),
        (["--stereo", "--views", "21"], "--views cannot be used with --stereo"),
        (["--stereo", "--raw", "RGGB"], "--raw cannot be used with --stereo"),
        ([BOARD, "--pairs", "2"], "--pairs needs --stereo"),
        ([BOARD, "--gray"], "--gray needs --stereo"),
        ([], "a board is needed"),
        (["--stereo", "--pairs", "0"], "0 pairs"),
        (["--stereo", "--pairs", "1001"], "1001 pairs"),
        (["--stereo", "--disparities", "64"], "as 6:64"),
        (["--stereo", "--disparities", "64:6"], "below the greatest"),
        (["--stereo", "--disparities", "6:64", "--distance", "1:3"], "leave one out"),
        (["--stereo", "--distance", "3:1"], "write NEAR:FAR, both positive"),
        (["--stereo", "--fov", "180"], "field of view"),
        (["--stereo", "--noise", "nan"], "finite"),
        (["--stereo", "--baseline", "0"], "positive"),
        (["--stereo", "--depth", "12"], "12 bits"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_nothing_is_written(run, folder, arguments, message):
    code, out, err = run("simulate", *arguments, "-o", folder)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not folder.exists()
