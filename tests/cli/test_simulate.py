"""`camcal simulate` as it is called from a shell: what it writes, refuses and repeats."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from camcal.formats import boards, cameras, detections, native, poses
from camcal.images.files import load
from camcal.targets.board import parse_board

BOARD = "chessboard:7x5:25mm"
SMALL = ("--size", "160x120", "--views", "3", "--jobs", "1", "--quiet")


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "simulated"


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_images_and_truth_are_written(run, folder):
    assert run("simulate", BOARD, "-o", folder, *SMALL, "--bow-mm", "1", "0.5") == (0, "", "")
    assert sorted(contents(folder)) == [
        "board.yaml",
        "corners.csv",
        "images/view0000.png",
        "images/view0001.png",
        "images/view0002.png",
        "poses.csv",
        "truth.yaml",
    ]
    assert load(folder / "images" / "view0000.png").pixels.shape == (120, 160)
    assert boards.read(folder / "board.yaml") == parse_board(BOARD)


def test_truth_poses_and_corners_fit_together(run, folder):
    run("simulate", BOARD, "-o", folder, *SMALL, "--bow-mm", "1", "0.5", "--twist-mm", "0.4", "--cubic-mm", "0.3")
    truth = native.read(folder / "truth.yaml")
    corners = detections.read(folder / "corners.csv")
    found = poses.read(folder / "poses.csv")
    points = truth.board_shape.points()
    assert (found.frames, found.unit) == ("camera_T_object", "m")
    for view, (key, record) in zip(corners.views, found.estimates.items(), strict=True):
        # The truth's shape leaves out what a pose takes, so the poses differ a little; the corners do not.
        fitted = truth.cameras["camera"].camera.project(record.transform.apply(points)).pixels
        assert (key.image, record.n_points) == (view.image, len(view.ids))
        assert np.abs(fitted - view.pixels).max() < 1.5  # pixels: 1.5 mm of 400 mm at a field of 160 px


@pytest.mark.slow
def test_the_same_options_give_the_same_bytes_whatever_the_jobs(run, tmp_path):
    for name, jobs in (("one", 1), ("two", 2)):
        run("simulate", BOARD, "-o", tmp_path / name, *SMALL, "--jobs", jobs)
    run("simulate", BOARD, "-o", tmp_path / "other", *SMALL, "--seed", "1")
    one, two, other = (contents(tmp_path / name) for name in ("one", "two", "other"))
    assert one == two
    assert one["images/view0000.png"] != other["images/view0000.png"]


@pytest.mark.parametrize(
    "options",
    [
        (BOARD, "--fov", "65", "--bow-mm", "0.7", "-0.4", "--stretch", "0.3", "--distortion", "k1=-0.21,k2=0.05"),
        (BOARD, "--raw", "RGGB", "--gain", "0.3", "--prnu", "0.7", "--light", ".5,1,.6", "--darks", "2"),
        ("--stereo", "--pairs", "2", "--distance", "0.8:12", "--right-gain", "0.9", "--gray", "--seed", "5"),
    ],
)
def test_the_recorded_command_gives_the_same_bytes(run, tmp_path, options):
    small = ("--size", "96x72", *(() if "--stereo" in options else ("--views", "2")))
    assert run("simulate", *options, *small, "-o", tmp_path / "one", "--jobs", "1", "-q") == (0, "", "")
    truth = native.read(tmp_path / "one" / ("rig.yaml" if "--stereo" in options else "truth.yaml"))
    words = shlex.split(truth.provenance["command"])
    assert run(*words[1:], "-o", tmp_path / "two", "--jobs", "1", "-q") == (0, "", "")
    assert contents(tmp_path / "one") == contents(tmp_path / "two")


def test_a_second_run_replaces_its_own_images(run, folder):
    run("simulate", BOARD, "-o", folder, *SMALL)
    assert run("simulate", BOARD, "-o", folder, *SMALL, "--views", "2")[0] == 0
    assert len(list((folder / "images").iterdir())) == 2


def test_a_folder_of_something_else_is_left_alone(run, folder):
    folder.mkdir()
    (folder / "truth.yaml").write_text("mine")
    code, _, err = run("simulate", BOARD, "-o", folder, *SMALL)
    assert code == 2
    assert "choose another folder" in err
    assert contents(folder) == {"truth.yaml": b"mine"}


def test_a_camera_file_can_be_given(run, folder, tmp_path):
    run("simulate", BOARD, "-o", folder, *SMALL, "--model", "kannala_brandt4", "--fov", "150")
    known = folder / "truth.yaml"
    assert run("simulate", BOARD, f"{known}#camera", "-o", tmp_path / "again", "--views", "1", "--quiet")[0] == 0
    first, second = (cameras.read_camera(path / "truth.yaml") for path in (folder, tmp_path / "again"))
    assert second.model.name == "kannala_brandt4"
    assert np.array_equal(first.parameters, second.parameters)


def test_coefficients_and_depth_are_taken(run, folder):
    run("simulate", BOARD, "-o", folder, *SMALL, "--distortion", "k1=-0.1,p2=0.001", "--depth", "16", "--gamma", "2.2")
    camera = cameras.read_camera(folder / "truth.yaml")
    assert (camera.value("k1"), camera.value("p2"), camera.value("k2")) == (-0.1, 0.001, 0.0)
    assert load(folder / "images" / "view0000.png").pixels.dtype == np.uint16


def test_json_is_one_document_with_a_frozen_schema(run, folder):
    code, out, err = run("simulate", BOARD, "-o", folder, *SMALL, "--json")
    document = json.loads(out)
    assert (code, err) == (0, "")
    assert list(document) == [
        "schema",
        "output",
        "model",
        "image_size",
        "parameters",
        "board",
        "deflection",
        "unit",
        "images",
        "corners",
        "warnings",
    ]
    assert document["schema"] == "camcal/simulate/1"
    assert document["corners"] == 3 * 35
    assert len(document["images"]) == 3


def test_a_person_reads_what_to_do_next(run, folder):
    code, out, _ = run("simulate", BOARD, "-o", folder, *SMALL[:-1], "--verbose")
    assert code == 0
    assert "3 images of 160x120, 105 corners" in out
    assert "next: camcal calibrate" in out
    assert "fx" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chess:7x5"], "expected chessboard"),
        ([BOARD, "--model", "opencv6"], "lens model"),
        ([BOARD, "--bow-mm", "100", "0"], "at most 7.5 mm"),
        ([BOARD, "--twist-mm", "nan"], "finite"),
        ([BOARD, "--noise", "nan"], "noise"),
        ([BOARD, "--gradient", "-20"], "gradient"),
        ([BOARD, "--size", "big"], "WIDTHxHEIGHT"),
        ([BOARD, "--fov", "190"], "field of view"),
        ([BOARD, "--fov", "0"], "field of view"),
        ([BOARD, "--distortion", "k1"], "k1=-0.2"),
        ([BOARD, "--distortion", "k9=1"], "k9"),
        ([BOARD, "--views", "0"], "0 views"),
        ([BOARD, "--blur", "-1"], "blur"),
        ([BOARD, "--depth", "12"], "12 bits"),
        ([BOARD, "--camera", "left"], "none is given"),
        (["chessboard:7x5", "--bow-mm", "1", "0"], "a bend in mm needs a board with a square size"),
        (["charuco:9x7:30mm:22mm:DICT_4X4_10"], "DICT_"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_nothing_is_written(run, folder, arguments, message):
    code, out, err = run("simulate", *arguments, "-o", folder)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not folder.exists()


def test_a_missing_camera_file_is_a_file_error(run, folder):
    assert run("simulate", BOARD, "missing.yaml", "-o", folder)[0] == 3


def test_a_camera_file_and_a_model_contradict_each_other(run, folder):
    run("simulate", BOARD, "-o", folder, *SMALL)
    code, _, err = run("simulate", BOARD, folder / "truth.yaml", "--fov", "60", "-o", folder / "again")
    assert code == 2
    assert "a camera file excludes" in err
