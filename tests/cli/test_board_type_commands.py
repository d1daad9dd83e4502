"""Photographs of every type of board, from `camcal simulate` to the camera file, by way of the command line."""

import json

import numpy as np
import pytest

from camcal.formats import boards, cameras
from camcal.tasks.simulation.options import BoardShape, SimulateOptions
from camcal.tasks.simulation.simulate import simulate

BOARDS = {
    "aprilgrid": "aprilgrid:4x3:60mm:0.3",
    "circles": "circles:8x6:25mm:15mm",
    "asymmetric_circles": "asymmetric_circles:4x9:20mm:12mm",
    "dots": "chessboard:8x6:25mm:dots",
}
FIRST, *OTHERS = BOARDS
WORDS = {
    "aprilgrid": "AprilGrid of 4x3 tags",
    "circles": "grid of 8x6 circles",
    "asymmetric_circles": "asymmetric grid of 4x9 circles",
    "dots": "chessboard of 8x6 inner corners and three dots",
}


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Photographs of every board, slightly bent, and the truth."""
    folder = tmp_path_factory.mktemp("scenes")
    for kind, board in BOARDS.items():
        bent = BoardShape(bow=(2e-3, 1e-3))
        simulate(SimulateOptions(folder / kind, board, size=(640, 480), views=6, shape=bent, jobs=1))
    return folder


@pytest.mark.parametrize("kind", [FIRST, *(pytest.param(kind, marks=pytest.mark.slow) for kind in OTHERS)])
def test_a_simulated_camera_is_calibrated_with_any_board(run, tmp_path, scenes, kind):
    folder, camera = scenes / kind, tmp_path / "camera.yaml"
    board = folder / "board.yaml"  # what simulate writes is what the others read
    assert boards.read(board) == boards.load_board(BOARDS[kind])
    words = ("--board", board, "--model", "opencv5", "-o", camera, "--jobs", "1", "--quiet")
    assert run("calibrate", folder / "images", *words)[0] == 0
    truth = cameras.read_camera(folder / "truth.yaml")
    found = cameras.read_camera(camera)
    for name in ("fx", "fy", "cx", "cy"):
        # 1 px of some 460: 6 views of 48 points or more, each good to 0.02 px, know the focal length to 0.2 px
        assert found.value(name) == pytest.approx(truth.value(name), abs=1.0)
    assert f"board {WORDS[kind]}, bent by" in run("inspect", camera)[1]


@pytest.mark.parametrize("kind", BOARDS)
def test_corners_and_poses_of_any_board_go_through_a_table(run, tmp_path, scenes, kind):
    folder, table = scenes / kind, tmp_path / "points.csv"
    assert run("detect", folder / "images", "--board", BOARDS[kind], "-o", table, "--jobs", "1", "--quiet")[0] == 0
    for points in (table, folder / "corners.csv"):
        code, out, _ = run("pnp", folder / "truth.yaml", points, "--json")
        assert code == 0
        rms = [pose["rms_px"] for pose in json.loads(out)["poses"]]
        assert len(rms) == 6
        assert np.max(rms) < 0.1  # a wrong number is off by 5 px and more


@pytest.mark.parametrize("kind", BOARDS)
def test_any_board_is_planned(run, kind):
    lens = ("--focal", 8, "--size", "1920x1080", "--pitch-um", 3.45)
    code, out, _ = run("optics", *lens, "--board", BOARDS[kind], "--views", 5)
    assert code == 0
    element = {"aprilgrid": "tag", "dots": "square"}.get(kind, "step")
    assert f"smallest {element}" in out
    assert f"and {element}s have" in out


@pytest.mark.parametrize(
    ("form", "size", "least"),
    [
        ("aprilgrid:6x4:{}mm:0.3", 60, 20),  # 10 cells of 2 px
        ("circles:8x6:{}mm", 25, 8),
        ("asymmetric_circles:4x9:{}mm", 20, 8),
    ],
)
def test_a_board_of_the_size_that_is_proposed_takes_the_share_that_was_asked_for(run, form, size, least):
    def planned(length):
        lens = ("--focal", 8, "--size", "1920x1080", "--pitch-um", 3.45, "--distance", 1, "--share", 0.7)
        return json.loads(run("optics", *lens, "--board", form.format(length), "--views", 5, "--json")[1])["board"]

    assert planned(size)["least_square_px"] == least
    proposed = planned(size)["distances"][0]["square_for_share_mm"]
    assert planned(f"{proposed:.6f}")["distances"][0]["share"] == pytest.approx(0.7, abs=1e-5)  # of the size's digits


@pytest.mark.parametrize(
    ("board", "message"),
    [
        ("circles:8x6:25mm", "grid of 8x6 circles needs a diameter to be drawn"),
        ("aprilgrid:30x20:60mm:0.3", "tag36h11 ends at 586"),
        ("aprilgrid:4x3:60mm", "is not the spacing as a share of the tag"),
        ("asymmetric:4x11:20mm:15mm", "did you mean 'asymmetric_circles:4x11:20mm:15mm'?"),
    ],
)
def test_a_board_that_cannot_be_drawn_is_refused_in_one_line(run, tmp_path, board, message):
    code, out, error = run("simulate", board, "-o", tmp_path / "none", "--views", 1, "--quiet")
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert message in error
    assert not (tmp_path / "none").exists()


def test_colours_are_refused_where_no_squares_meet(run, tmp_path, scenes):
    arguments = ("--board", BOARDS["circles"], "-o", tmp_path / "camera.yaml", "--channels", "--jobs", "1")
    code, _, error = run("calibrate", scenes / "circles" / "images", *arguments)
    assert code == 2
    assert "colours need a board with checkerboard corners, not a grid of 8x6 circles" in error
