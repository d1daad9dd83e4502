"""`camcal detect`: what it prints, and its exit codes."""

import json

import cv2
import numpy as np
import pytest

from camcal.cli import targets


@pytest.fixture
def folder(tmp_path):
    """A folder with a board of 6 x 5 inner corners, a wall and a file that is no image."""
    row, column = np.mgrid[0:6, 0:7]
    board = np.kron(np.where((row + column) % 2, 220, 30), np.ones((30, 30))).astype(np.uint8)
    board = cv2.copyMakeBorder(board, 30, 30, 55, 55, cv2.BORDER_CONSTANT, value=220)
    images = tmp_path / "images"
    images.mkdir()
    cv2.imwrite(str(images / "board.png"), board)
    cv2.imwrite(str(images / "wall.png"), np.full_like(board, 120))
    return images


def test_a_table_says_what_every_image_shows(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, out, err = run("detect", folder, "--board", "chessboard:6x5:25mm", "-o", output, "--jobs", 1)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "1 of 2 images show the board"
    assert lines[1].split() == ["image", "corners", "reason"]
    assert lines[2].split() == [f"{folder}/board.png", "30"]
    assert lines[3].split(maxsplit=2) == [f"{folder}/wall.png", "0", "no chessboard found"]
    assert lines[-1] == f"wrote {output}"
    assert output.read_text().startswith("# camcal-detections 1 board=chessboard:6x5:25mm\nimage,width,height,id,u,v\n")


def test_json_is_one_document_with_its_schema_first(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, out, _ = run("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1, "--json")
    told = json.loads(out)
    assert code == 0
    assert list(told) == ["schema", "output", "board", "images", "notes", "failed"]
    assert told["schema"] == "camcal/detect/1"
    assert told["images"][0] == {
        "image": f"{folder}/board.png", "image_size": [320, 240], "corners": 30, "reason": None, "orientation": 1,
    }  # fmt: skip


def test_an_image_that_cannot_be_read_makes_the_exit_six_and_the_rest_is_written(run, folder, tmp_path):
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 cut off")
    output = tmp_path / "corners.csv"
    code, out, err = run("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1)
    assert code == 6
    assert f"failed: {folder}/broken.jpg: " in out
    assert err == "camcal: error: 1 of the images could not be read, the rest is written\n"
    assert output.read_text().count("board.png") == 30


def test_nothing_is_written_where_no_image_shows_the_board(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, _, err = run("detect", folder, "-b", "chessboard:7x6", "-o", output, "--jobs", 1)
    assert code == 4
    assert err.startswith("camcal: error: no chessboard of 7x6 inner corners")
    assert not output.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--board is needed, such as --board chessboard:9x6:25mm"),
        (("--board", "chessboard:6by5"), "'6by5' is not a size; write 9x6"),
        (("--board", "chessboard:6x5", "--jobs", "0"), "Invalid value for '--jobs'"),
    ],
)
def test_a_wrong_argument_is_one_line_and_exit_two(run, folder, tmp_path, arguments, message):
    code, _, err = run("detect", folder, "-o", tmp_path / "corners.csv", *arguments)
    assert code == 2
    assert message in err
    assert err.count("\n") == 1


def test_a_missing_folder_is_exit_three(run, tmp_path):
    code, _, err = run("detect", tmp_path / "none", "-b", "chessboard:6x5", "-o", tmp_path / "corners.csv")
    assert (code, err.count("\n")) == (3, 1)


def test_quiet_prints_nothing(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    assert run("detect", folder, "-b", "chessboard:6x5", "-o", output, "--jobs", 1, "--quiet") == (0, "", "")


def test_of_many_images_those_without_corners_are_listed(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr(targets, "LISTED", 1)
    arguments = ("detect", folder, "-b", "chessboard:6x5", "-o", tmp_path / "corners.csv", "--jobs", 1)
    _, out, _ = run(*arguments)
    assert "wall.png" in out
    assert "board.png" not in out
    assert "… and 1 with corners (--verbose lists all)" in out
    assert "board.png" in run(*arguments, "--verbose")[1]
