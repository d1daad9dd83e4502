"""What somebody meets who tries a command for the first time: wrong words, files of other kinds, forgotten units."""

import shlex

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cli.examples import EXAMPLES
from camcal.cli.main import COMMANDS
from camcal.formats import detections, native
from camcal.formats.camera_file import CameraEntry, CameraFile
from camcal.images.files import save
from camcal.simulate.scene import observe, views
from camcal.targets.board import Board

HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic"
FISHEYE = Camera(model_named("fisheye"), (640, 480), np.array([200.0, 200, 320, 240, 0.05, -0.01, 0.003, -0.001]))


@pytest.fixture
def corners(tmp_path):
    """A function that writes the corners that a fisheye sees of a board, 0.04 m or of no known size."""

    def write(square=0.04):
        board, rng = Board("chessboard", 9, 6, square), np.random.default_rng(1)
        seen = observe(FISHEYE, board, views(FISHEYE, board, 8, rng=rng), rng=rng, noise_px=0.1)[0]
        detections.write(tmp_path / "corners.csv", seen)
        return tmp_path / "corners.csv"

    return write


def test_a_coefficient_of_a_fisheye_is_held_and_an_unknown_one_is_told_with_the_models_that_have_it(
    run, corners, tmp_path
):
    output, table = tmp_path / "camera.yaml", corners()
    assert run("calibrate", table, "-o", output, "--model", "fisheye", "--fix", "k4", "-j", 1, "-q")[0] == 0
    assert native.read(output).cameras["camera"].camera.fixed == ("k4",)
    code, _, err = run("calibrate", table, "-o", output, "--model", "opencv5", "--fix", "k4", "-j", 1)
    assert code == 2
    assert "opencv5 has no parameter 'k4'; it has fx, fy, cx, cy, k1, k2, p1, p2, k3; models that have it: " in err
    assert "kannala_brandt4" in err
    code, _, err = run("calibrate", table, "-o", output, "--model", "fisheye", "--fix", "k9", "-j", 1)
    assert (code, err.count("models that have it")) == (2, 0)


def test_the_header_of_a_camera_file_says_the_unit_of_its_lengths(run, corners, tmp_path):
    native.write(tmp_path / "metres.yaml", CameraFile({"camera": CameraEntry(FISHEYE)}))
    run("calibrate", corners(None), "-o", tmp_path / "squares.yaml", "--model", "fisheye", "-j", 1, "-q")
    for name, unit in (("metres", "metres"), ("squares", "squares of the board")):
        assert f"# camcal camera file. Units: pixels, {unit}, radians." in (tmp_path / f"{name}.yaml").read_text()


@pytest.mark.parametrize("name", ["IMG_1.HEIC", "IMG_1.jpg"])
def test_phone_images_that_are_not_read_are_told_with_what_to_do(run, tmp_path, name):
    (tmp_path / "phone").mkdir()
    (tmp_path / "phone" / name).write_bytes(HEIC)
    command = ("detect", tmp_path / "phone", "--board", "chessboard:9x6:25mm", "-o", tmp_path / "corners.csv", "-j", 1)
    code, _, err = run(*command)
    assert code == 3
    assert "HEIF images are not read: convert them to PNG or JPEG first" in err
    assert "heif-convert photo.heic photo.png" in err
    if name.endswith("HEIC"):
        assert "phone: holds no image (1 .heic); HEIF" in err


def test_a_folder_of_other_files_is_told_without_advice(run, tmp_path):
    (tmp_path / "notes.txt").write_text("none")
    code, _, err = run("detect", tmp_path, "--board", "chessboard:9x6:25mm", "-o", tmp_path / "corners.csv")
    assert (code, "convert" in err, "holds no image (1 .txt)" in err) == (3, False, True)


def test_a_colour_that_is_no_matrix_is_told_what_there_is(run, tmp_path):
    save(tmp_path / "mosaic.png", np.zeros((8, 8), np.uint16))
    code, _, err = run(
        "demosaic", tmp_path / "mosaic.png", "--pattern", "RGGB", "-o", tmp_path / "x.png", "--colour", "rgb"
    )
    assert code == 2
    assert "--colour 'rgb': it is none, srgb, or a file of nine numbers" in err
    assert "--colour srgb" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("detect x --board chessboard:9x6:25 -o y.csv", "'25' has no unit; write 25mm if it is in millimetres"),
        ("board charuco:9x7:30mm:22:DICT_5X5_100 -o y.svg", "'22' has no unit; write 22mm"),
        ("board aprilgrid:6x6:88:0.3 -o y.svg", "'88' has no unit; write 88mm"),
        ("board circles:10x8:25:15 -o y.svg", "'25' has no unit; write 25mm"),
        ("board chessboard:9x6:25km -o y.svg", "'25km' is not a length with its unit; write 25mm, 2.5cm"),
        ("pnp camera.yaml x --tags tag36h11:50 -o y.yaml", "'50' has no unit; write 50mm"),
        ("optics --f 8 --coc 5", "write a diameter with its unit, such as 5um"),
        ("optics --f 8mm", "'8mm' is not a number; give millimetres, without the unit"),
        ("stereo cloud x.png --baseline 10cm -o y.ply", "'10cm' is not a number; give metres, without the unit"),
    ],
)
def test_a_length_without_its_unit_and_a_number_with_one_are_told_what_to_write(
    run, arguments, said, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x").mkdir()
    save(tmp_path / "x" / "1.png", np.zeros((8, 8), np.uint8))
    native.write(tmp_path / "camera.yaml", CameraFile({"camera": CameraEntry(FISHEYE)}))
    code, _, err = run(*arguments.split())
    assert code == 2
    assert said in err


CALLS = [example.call for each in EXAMPLES.values() for example in each]
ALONE = {"demo", "doctor"}  # commands that need nothing


def test_every_command_has_three_common_calls():
    assert set(EXAMPLES) == {entry.name for entry in COMMANDS if entry.function}
    assert {len(each) for each in EXAMPLES.values()} == {3}
    assert max(map(len, CALLS)) <= 90
    assert len(set(CALLS)) == len(CALLS)
    assert all(example.call.startswith(name) for name, each in EXAMPLES.items() for example in each)


def test_what_a_common_call_does_is_said_in_a_line_of_its_own():
    purposes = [example.purpose for each in EXAMPLES.values() for example in each]
    assert max(map(len, purposes)) <= 78
    assert not any(purpose.endswith(".") or purpose.startswith(("#", " ", "camcal")) for purpose in purposes)


@pytest.mark.parametrize(
    "call",
    [
        pytest.param(example.call, marks=[pytest.mark.slow] * (number > 0))
        for each in EXAMPLES.values()
        for number, example in enumerate(each)
    ],
)
def test_a_common_call_is_one_that_the_command_takes(run, tmp_path, call, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(*shlex.split(call), "--write-config", "settings.yaml")
    assert (code, err) == (0, "")
    assert "settings.yaml" in out


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - ALONE))
def test_a_command_called_with_nothing_shows_its_most_common_calls(run, name):
    code, out, err = run(*name.split())
    assert (code, out) == (2, "")
    first, *rest = err.splitlines()
    assert first.startswith("camcal: error: ")
    assert rest == ["most common calls:", *(f"  camcal {example.call}" for example in EXAMPLES[name])]


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_a_script_of_calls_with_what_each_does(run, name):
    code, out, err = run(*name.split(), "--examples")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    lines = out.replace(" \\\n    ", " ").splitlines()
    assert lines == [line for each in EXAMPLES[name] for line in (f"# {each.purpose}", f"camcal {each.call}")]


def test_a_command_that_needs_nothing_and_fails_lists_no_calls(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camcal-demo").mkdir()
    (tmp_path / "camcal-demo" / "camera.yaml").write_text("mine: 1\n")
    code, _, err = run("demo")
    assert code == 2
    assert "most common calls" not in err


def test_help_ends_with_the_most_common_calls(run):
    shown = run("calibrate", "--help")[1].splitlines()
    assert shown[-4:] == ["Examples:", *(f"  camcal {example.call}" for example in EXAMPLES["calibrate"])]


def test_help_keeps_to_its_width_and_has_one_order_of_names(run):
    for command in ("track", "detect", "simulate"):
        out = run(command, "--help")[1]
        assert max(map(len, out.splitlines())) <= 80
        assert "-h, --help" in out
    assert " --board chessboard:9x6:25mm \\\n      -o track.csv --plot" in run("track", "--help")[1]
