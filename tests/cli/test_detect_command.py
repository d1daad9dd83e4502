"""`camcal detect`: what it prints, and its exit codes."""

import json
import shutil

import cv2
import numpy as np
import pytest


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
    assert lines[0] == "1 of 2 images with the board"
    assert lines[1].split() == ["image", "corners", "reason"]
    assert lines[2].split() == ["board.png", "30"]
    assert lines[3].split(maxsplit=2) == ["wall.png", "0", "no chessboard found"]
    assert lines[-1] == f"wrote {output}"
    assert output.read_text().startswith(
        "# camcal-detections 1 board=chessboard:6x5:25mm\nimage,width,height,id,u,v,suu,suv,svv\n"
    )


def test_json_is_one_document_with_its_schema_first(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, out, _ = run("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1, "--json")
    told = json.loads(out)
    assert code == 0
    assert list(told) == [
        "schema",
        "output",
        "board",
        "image_circle",
        "images",
        "frames",
        "failed",
        "pictures",
        "reused",
        "timings",
        "warnings",
    ]
    assert told["schema"] == "camcal/detect/1"
    assert told["images"][0] == {
        "image": f"{folder}/board.png", "image_size": [320, 240], "corners": 30, "reason": None, "orientation": 1,
    }  # fmt: skip


def test_an_image_that_cannot_be_read_makes_the_exit_six_and_the_rest_is_written(run, folder, tmp_path):
    (folder / "broken.jpg").write_bytes(b"\xff\xd8\xff\xe0 cut off")
    output = tmp_path / "corners.csv"
    code, out, err = run("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1)
    assert code == 6
    assert "broken.jpg" not in out
    failed, error = err.splitlines()
    assert failed.startswith(f"camcal: failed: {folder}/broken.jpg: ")
    again = "with --resume the others are not searched again"
    assert error == f"camcal: error: 1 image could not be read, the rest is written; {again}"
    assert output.read_text().count("board.png") == 30


def test_nothing_is_written_where_no_image_shows_the_board(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    code, _, err = run("detect", folder, "-b", "chessboard:7x6", "-o", output, "--jobs", 1)
    assert code == 4
    assert err.startswith("camcal: error: no chessboard of 7x6 inner corners")
    assert not output.exists()


def test_a_board_of_circles_is_proposed_in_the_form_that_the_option_takes(run, tmp_path):
    row, column = np.mgrid[0:400, 0:480].astype(float)
    image = np.full((400, 480), 220.0)
    for index in range(7 * 3):
        v, u = 70 + 40 * (index // 3), 120 + 80 * (index % 3) + 40 * (index // 3 % 2)
        image = np.minimum(image, 30 + 190 * np.clip(np.hypot(column - u, row - v) - 14, 0, 1))
    cv2.imwrite(str(tmp_path / "dots.png"), image.astype(np.uint8))
    code, _, err = run("detect", tmp_path, "-b", "asymmetric_circles:4x11:20mm", "-o", tmp_path / "a.csv", "--jobs", 1)
    assert code == 4
    assert err == (
        "camcal: error: no asymmetric grid of 4x11 circles in 1 of 1 image, but an asymmetric grid of 3x7 circles in "
        "1; use --board asymmetric_circles:3x7:20mm\n"
    )
    board = err.split()[-1]
    assert run("detect", tmp_path, "-b", board, "-o", tmp_path / "a.csv", "--jobs", 1)[0] == 0


def test_images_of_other_sizes_are_used_with_their_option(run, folder, tmp_path):
    image = cv2.imread(str(folder / "board.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "board2.png"), image)
    cv2.imwrite(str(folder / "cropped.png"), image[:-1, :-2])
    output = tmp_path / "corners.csv"
    command = ("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1)
    code, out, _ = run(*command)
    assert code == 0
    assert "image 318x239 differs from the majority 320x240: 2 x 1 px off; --mixed-sizes uses it" in " ".join(
        out.split()
    )
    code, out, _ = run(*command, "--mixed-sizes")
    assert code == 0
    assert "3 of 4 images with the board" in out
    assert output.read_text().count("cropped.png,320,240,") == 30


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


def test_a_part_of_a_board_is_taken_if_asked_for(run, folder, tmp_path):
    board = cv2.imread(str(folder / "board.png"))
    cv2.imwrite(str(folder / "wall.png"), np.ascontiguousarray(np.pad(board[:, 95:], ((0, 0), (0, 95), (0, 0)))))
    arguments = ("detect", folder, "-b", "chessboard:6x5:25mm", "-o", tmp_path / "corners.csv", "--jobs", 1, "--json")
    whole, partial = (json.loads(run(*arguments, *extra)[1])["images"] for extra in ((), ("--partial",)))
    assert [image["corners"] for image in whole] == [30, 0]
    assert partial[0]["corners"] == 30
    assert 15 <= partial[1]["corners"] <= 25


@pytest.fixture
def video(folder, tmp_path):
    """A video of eight frames in which the board of the folder moves to the right, and a wall in the end."""
    board, wall = (cv2.imread(str(folder / name)) for name in ("board.png", "wall.png"))
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, board.shape[1::-1])
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for frame in (*(np.roll(board, 4 * step, axis=1) for step in range(7)), wall):
        writer.write(frame)
    writer.release()
    return path


def test_the_choice_of_frames_is_listed(run, video, tmp_path):
    arguments = ("detect", video, "-b", "chessboard:6x5:25mm", "-o", tmp_path / "corners.csv", "--jobs", 1)
    code, out, err = run(*arguments, "--max-frames", 2)
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "2 of 8 searched frames used"
    assert lines[1].split() == ["frame", "corners", "blur,", "px", "motion,", "px", "order", "reason"]
    assert [line.split()[-2:] for line in lines[2:4]] == [["adds", "most"]] * 2
    assert lines[4] == "  (--verbose lists all searched frames)"
    assert "video.avi: 2 of 8 frames used; 8 searched, 7 with the board" in out
    verbose = run(*arguments, "--max-frames", 2, "--verbose")[1]
    assert "no chessboard found" in verbose
    assert verbose.count(str(video.with_suffix(""))) >= 8


def test_json_has_every_frame_with_its_figures(run, video, tmp_path):
    arguments = ("detect", video, "-b", "chessboard:6x5:25mm", "-o", tmp_path / "corners.csv", "--jobs", 1, "--json")
    told = json.loads(run(*arguments, "--every", 7)[1])
    first, last = told["frames"]
    assert first["frame"] == f"{video.with_suffix('')}_000000"
    assert (first["taken"], first["reason"], first["order"], first["motion_px"]) == (True, "adds most", 1, None)
    assert 0 < first["blur_px"] < 3
    assert (last["corners"], last["taken"], last["order"]) == (0, False, None)
    everything = json.loads(run(*arguments, "--all-frames")[1])
    assert [frame["taken"] for frame in everything["frames"]] == [True] * 7 + [False]
    assert len(everything["images"]) == 8


def test_pictures_are_drawn_and_named(run, folder, tmp_path):
    drawn = tmp_path / "drawn"
    output = tmp_path / "corners.csv"
    arguments = ("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--draw", drawn, "--jobs", 1)
    code, out, _ = run(*arguments)
    assert code == 0
    assert out.splitlines()[-1] == f"wrote {output} and 2 pictures to {drawn}/"
    assert sorted(path.name for path in drawn.glob("*.png")) == ["board_corners.png", "wall_corners.png"]
    assert json.loads(run(*arguments, "--json")[1])["pictures"] == [
        f"{drawn}/board_corners.png", f"{drawn}/wall_corners.png",
    ]  # fmt: skip


def test_pictures_say_why_where_no_image_shows_the_board(run, folder, tmp_path):
    drawn, output = tmp_path / "drawn", tmp_path / "corners.csv"
    code, _, err = run("detect", folder, "-b", "circles:6x5", "-o", output, "--draw", drawn, "--jobs", 1)
    assert (code, len(err.splitlines())) == (4, 1)
    assert sorted(path.name for path in drawn.glob("*.png")) == ["board_corners.png", "wall_corners.png"]
    assert not output.exists()


def test_quiet_prints_nothing(run, folder, tmp_path):
    output = tmp_path / "corners.csv"
    assert run("detect", folder, "-b", "chessboard:6x5:25mm", "-o", output, "--jobs", 1, "--quiet") == (0, "", "")


def test_of_many_images_those_without_corners_are_listed(run, folder, tmp_path, monkeypatch):
    monkeypatch.setattr("camcal.cli.calibrate.IMAGES_LISTED", 1)
    arguments = ("detect", folder, "-b", "chessboard:6x5", "-o", tmp_path / "corners.csv", "--jobs", 1)
    _, out, _ = run(*arguments)
    assert "wall.png" in out
    assert "board.png" not in out
    assert "… and 1 with corners (--verbose lists all)" in out
    assert "board.png" in run(*arguments, "--verbose")[1]


@pytest.mark.parametrize(
    ("board", "line"),
    [
        ("charuco:6x4:40mm:30mm:DICT_4X4_50", "board printed inverted, white on black, in 1 image"),
        ("chessboard:6x5:25mm", "board with a dark margin, as if printed inverted, white on black, in 1 image"),
    ],
)
def test_a_board_printed_white_on_black_is_said(run, tmp_path, board, line):
    assert run("board", board, "-o", tmp_path / "board.png", "--dpi", 100)[0] == 0
    cv2.imwrite(str(tmp_path / "board.png"), 255 - cv2.imread(str(tmp_path / "board.png"), cv2.IMREAD_GRAYSCALE))
    code, out, _ = run("detect", tmp_path / "board.png", "--board", board, "-o", tmp_path / "corners.csv")
    assert code == 0
    assert f"{line}\n" in out


@pytest.mark.parametrize(
    ("board", "tried", "words"),
    [
        ("chessboard:6x5:25mm", 40, "chessboard of 6x5 inner corners"),
        ("charuco:6x5:30mm:22mm:DICT_4X4_50", 16, "ChArUco board of 6x5 squares"),
        ("aprilgrid:4x3:40mm:0.3", 10, "AprilGrid of 4x3 tags"),
        ("circles:7x6:25mm:15mm", 16, "grid of 7x6 circles"),
        ("asymmetric_circles:4x11:20mm:15mm", 16, "asymmetric grid of 4x11 circles"),
    ],
)
def test_one_of_a_few_images_that_are_spread_evenly_must_show_the_board(run, tmp_path, board, tried, words):
    assert run("board", board, "-o", tmp_path / "board.png", "--dpi", 36)[0] == 0
    cv2.imwrite(str(tmp_path / "wall.png"), np.full_like(cv2.imread(str(tmp_path / "board.png"), 0), 110))
    images = tmp_path / "images"
    images.mkdir()
    for index in range(2 * tried):
        shutil.copy(tmp_path / "wall.png", images / f"{index}.png")
    arguments = ("detect", images, "--board", board, "-o", tmp_path / "corners.csv", "--jobs", 1)
    shutil.copy(tmp_path / "board.png", images / "3.png")  # every second image is searched
    code, _, err = run(*arguments)
    assert code == 4
    assert f"no {words} in any of {tried} images tested of {2 * tried} ({tried} times: " in err
    assert err.endswith("and the images, or give only images that show the board\n")
    assert run("detect", images / "3.png", *arguments[2:])[0] == 0
    shutil.copy(tmp_path / "board.png", images / "2.png")
    assert "2 of " in run(*arguments, "--overwrite")[1]
