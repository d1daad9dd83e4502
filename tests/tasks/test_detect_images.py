"""Sets of images on disk: which are used, which are not and why, and the same bytes whatever the number of jobs.

The pictures are warped from a drawing, good to tenths of a pixel; accuracy is tested in tests/targets.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from opencv_charuco import drawn_by_opencv

from camcal.errors import FileError, InsufficientData, InvalidInput
from camcal.formats import detections
from camcal.targets.board import Board, parse_board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration import which_board
from camcal.tasks.calibration.detect import detect_images, document
from camcal.tasks.calibration.options import DetectOptions
from camcal.tasks.calibration.which_board import nothing_found

BOARD = Board("chessboard", 6, 5, 0.03)
CHARUCO = parse_board("charuco:6x4:40mm:30mm:DICT_4X4_50")
SIZE = (320, 240)
CELL = 24


def drawing(board):
    """Return a board of CELL pixels a square with a white margin of one square."""
    if board.type == "charuco":
        squares = drawn_by_opencv(board, CELL)
    else:
        row, column = np.mgrid[0 : board.rows + 1, 0 : board.columns + 1]
        squares = np.kron(np.where((row + column) % 2, 220, 30), np.ones((CELL, CELL))).astype(np.uint8)
    return cv2.copyMakeBorder(squares, CELL, CELL, CELL, CELL, cv2.BORDER_CONSTANT, value=220)


def write(path, board, seed=0, size=SIZE, quality=95):
    """Write the picture of a board in a pose of its own; return the path."""
    rng = np.random.default_rng(seed)
    flat = drawing(board)
    height, width = flat.shape
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    shown = 0.82 * min(size[0] / width, size[1] / height) * (corners - [width / 2, height / 2])
    shown += np.array(size) / 2 + rng.uniform(-9, 9, (4, 2))
    warp = cv2.getPerspectiveTransform(corners, shown.astype(np.float32))
    image = cv2.warpPerspective(flat, warp, size, flags=cv2.INTER_AREA, borderValue=120)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return path


def write_wall(path, size=SIZE):
    cv2.imwrite(str(path), np.full(size[::-1], 110, np.uint8))
    return path


def with_orientation(path, tag):
    """Put an EXIF block that says only the orientation into a JPEG file."""
    tiff = b"II*\0" + (8).to_bytes(4, "little") + (1).to_bytes(2, "little")
    tiff += b"\x12\x01\x03\0\x01\0\0\0" + tag.to_bytes(4, "little") + bytes(4)
    block = b"Exif\0\0" + tiff
    content = path.read_bytes()
    path.write_bytes(content[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + content[2:])


def found(folder, board=BOARD, **options):
    return detect_images(DetectOptions((folder,), board, jobs=1, **options))


def test_every_image_has_its_place_and_its_reason(tmp_path):
    write(tmp_path / "2.png", BOARD, 1)
    write(tmp_path / "10.png", BOARD, 2)
    write_wall(tmp_path / "3.png")
    write(tmp_path / "4.png", BOARD, 3, size=(240, 180))
    (tmp_path / "5.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    report = found(tmp_path)
    views = report.detections.views
    assert [view.image.rsplit("/", 1)[-1] for view in views] == ["2.png", "3.png", "4.png", "10.png"]
    assert [len(view.ids) for view in views] == [30, 0, 0, 30]
    assert [view.reason for view in views] == [
        None, "no chessboard found", "image 240x180 differs from the majority 320x240", None,
    ]  # fmt: skip
    assert report.used == 2
    [failed] = report.failed
    assert failed.startswith(f"{tmp_path}/5.png: ")


@pytest.mark.slow
def test_the_same_bytes_come_out_whatever_the_number_of_jobs(tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    for seed in range(3):
        write(images / f"{seed}.jpg", BOARD, seed)
    for jobs in (1, 2):
        detect_images(DetectOptions((images,), BOARD, tmp_path / f"{jobs}.csv", jobs=jobs))
    content = (tmp_path / "1.csv").read_bytes()
    assert content.count(b"\n") == 2 + 3 * BOARD.count
    assert content == (tmp_path / "2.csv").read_bytes()


@pytest.mark.parametrize("suffix", [".csv", ".vnl"])
def test_the_file_holds_what_was_found(tmp_path, suffix):
    image = write(tmp_path / "a.png", BOARD)
    output = tmp_path / f"corners{suffix}"
    report = detect_images(DetectOptions((image,), BOARD, output, jobs=1))
    [view] = detections.read(output, BOARD, SIZE).views
    np.testing.assert_array_equal(view.ids, report.detections.views[0].ids)
    np.testing.assert_allclose(view.pixels, report.detections.views[0].pixels, atol=1e-5)  # a .vnl has fewer digits


@pytest.mark.parametrize(
    ("drawn", "asked", "said"),
    [
        (replace(CHARUCO, legacy=False), CHARUCO, ["current ChArUco pattern (OpenCV >= 4.6)"]),
        (replace(CHARUCO, legacy=True), CHARUCO, ["legacy ChArUco pattern (OpenCV < 4.6)"]),
        (replace(CHARUCO, legacy=True), replace(CHARUCO, legacy=True), []),
        (
            parse_board("charuco:5x7:40mm:30mm:DICT_4X4_50"),
            parse_board("charuco:7x5:40mm:30mm:DICT_4X4_50"),
            ["the board has 5x7 squares, not 7x5: the found size is used"],
        ),
    ],
    ids=["current", "legacy", "as stated", "transposed"],
)
def test_the_arrangement_of_a_charuco_board_is_found_out_and_told(tmp_path, drawn, asked, said):
    for seed in range(2):
        write(tmp_path / f"{seed}.png", drawn, seed)
    report = found(tmp_path, asked)
    assert report.used == 2
    board = report.detections.board
    assert (board.columns, board.rows, board.legacy) == (drawn.columns, drawn.rows, bool(drawn.legacy))
    assert [*map(str, report.warnings), *report.lines] == said


def test_squares_given_for_corners_end_with_the_size_that_was_found(tmp_path):
    for seed in range(2):
        write(tmp_path / f"{seed}.png", BOARD, seed)
    with pytest.raises(InsufficientData) as raised:
        found(tmp_path, Board("chessboard", 7, 6))
    assert str(raised.value) == (
        "no chessboard of 7x6 inner corners in 2 of 2 images, but a checker pattern of 6x5 in 2; "
        "sizes count inner corners, not squares: use --board chessboard:6x5"
    )


DRAWN = parse_board("charuco:6x5:40mm:30mm:DICT_4X4_50")


@pytest.mark.parametrize(
    ("asked", "differs", "tried"),
    [
        ("6x5:40mm:20mm:DICT_4X4_50", "markers of 30 mm, not 20 mm", " in 3 of 3 images: 2 of 2"),
        ("6x5:40mm:30mm:DICT_5X5_100", "DICT_4X4_50, not DICT_5X5_100", " in 3 of 3 images: 2 of 2"),
        ("7x8:40mm:30mm:DICT_4X4_50", "6x5 squares, not 7x8", " in 3 of 3 images: 2 of 2"),
        ("6x6:40mm:30mm:DICT_4X4_50", "6x5 squares, not 6x6", ": 3 of 3"),
    ],
    ids=["marker", "dictionary", "size", "rows"],
)
def test_another_charuco_board_ends_with_the_one_that_images_show(tmp_path, asked, differs, tried):
    for seed in range(3):
        write(tmp_path / f"{seed}.png", DRAWN, seed, size=(480, 400))
    with pytest.raises(InsufficientData) as raised:
        found(tmp_path, parse_board(f"charuco:{asked}"))
    assert str(raised.value) == (
        f"no ChArUco board of {asked[:3]} squares{tried} tested images show {differs}; "
        "use --board charuco:6x5:40mm:30mm:DICT_4X4_50"
    )


def test_the_charuco_board_that_is_proposed_is_found_in_all_images(tmp_path):
    for seed in range(3):
        write(tmp_path / f"{seed}.png", DRAWN, seed, size=(480, 400))
    assert found(tmp_path, parse_board("charuco:6x5:40mm:30mm:DICT_4X4_50")).used == 3


def test_a_board_whose_last_row_is_out_of_sight_is_taken_as_stated(tmp_path):
    for seed in range(3):
        path = write(tmp_path / f"{seed}.png", DRAWN, seed, size=(480, 400))
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        image[300:] = 100
        cv2.imwrite(str(path), image)
    asked = replace(DRAWN, rows=7)
    assert found(tmp_path, asked).used == 3


def test_a_chessboard_of_another_size_is_not_proposed_for_a_charuco_board(tmp_path):
    write(tmp_path / "a.png", BOARD)
    with pytest.raises(InsufficientData, match="check squares, dictionary"):
        found(tmp_path, CHARUCO)


def test_other_boards_are_tried_on_a_few_images_only(tmp_path, monkeypatch):
    tried = []
    monkeypatch.setattr(which_board, "search_charuco", lambda gray, like: tried.append(like))
    for index in range(20):
        write_wall(tmp_path / f"{index}.png", (64, 48))
    with pytest.raises(
        InsufficientData,
        match=r"in any of 16 images tested of 20 .* no other ChArUco board in 6 of them; check squares",
    ):
        found(tmp_path, CHARUCO)
    assert 0 < len(tried) <= which_board.SAMPLE


@pytest.mark.slow
def test_images_of_other_sizes_are_used_if_asked_for(tmp_path):
    for seed in range(4):
        write(tmp_path / f"{seed}.png", BOARD, seed)
    whole = found(tmp_path).detections.views[3]
    image = cv2.imread(str(tmp_path / "3.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "3.png"), cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR))
    assert found(tmp_path).detections.views[3].reason.endswith(": twice as large; --mixed-sizes uses it")
    left_out = found(tmp_path, mixed_sizes=False)
    assert left_out.detections.views[3].reason.endswith(": twice as large; --mixed-sizes uses it")
    report = found(tmp_path, mixed_sizes=True, draw=tmp_path / "drawn")
    view = report.detections.views[3]
    assert view.size == SIZE
    difference = view.pixels - whole.pixels
    assert np.abs(difference.mean(axis=0)).max() < 0.01  # half a pixel if the map were wrong
    assert np.abs(difference).max() < 0.15  # the picture's own errors
    assert report.warnings[-1].text.startswith("used with --mixed-sizes: 1 image of 640x480, twice as large")
    assert len(report.pictures) == 4


def test_a_board_that_is_nowhere_ends_with_advice(tmp_path):
    write_wall(tmp_path / "a.png")
    with pytest.raises(InsufficientData, match=r"in the image \(1 time: no chessboard found\); check the size"):
        found(tmp_path)
    with pytest.raises(InsufficientData, match=r"no ChArUco board of 6x4 squares in the image .* check squares"):
        found(tmp_path, CHARUCO)


def test_a_part_of_a_larger_board_is_not_taken_for_the_board():
    """Some detectors find 5 x 3 corners in some images of a 6 x 4 board; more images then show the larger pattern."""
    board = Board("chessboard", 5, 3)
    views = [
        view_of(board),
        *[BoardDetection("a.png", SIZE, reason="another pattern", other=Board("chessboard", 6, 4))] * 2,
    ]
    assert nothing_found(views, board).exit_code == InsufficientData.exit_code
    assert nothing_found(views[:2], board) is None


def view_of(board):
    return BoardDetection("b.png", SIZE, np.arange(board.count), np.zeros((board.count, 2)))


def test_a_view_has_the_hash_of_the_file_it_was_detected_in(tmp_path):
    image = write(tmp_path / "a.png", BOARD)
    np.save(tmp_path / "b.npy", cv2.imread(str(image), cv2.IMREAD_UNCHANGED))
    for view in found(tmp_path).detections.views:
        assert view.sha256 == hashlib.sha256(Path(view.image).read_bytes()).hexdigest()


def test_exif_orientation_is_noted_and_not_applied(tmp_path):
    image = write(tmp_path / "a.jpg", BOARD)
    [before] = found(image).detections.views
    with_orientation(image, 6)
    report = found(image)
    [after] = report.detections.views
    assert (after.size, after.orientation) == (SIZE, 6)
    np.testing.assert_array_equal(after.pixels, before.pixels)
    assert "orientation_ignored" in [warning.code for warning in report.warnings]


def test_unknown_squares_and_boards_that_look_the_same_turned_are_told(tmp_path):
    write(tmp_path / "a.png", Board("chessboard", 6, 4))
    kept = {"output": tmp_path / "corners.csv"}
    for options, told in ((kept, ["unknown_board_size", "symmetric_board"]), ({}, ["unknown_board_size"])):
        codes = [warning.code for warning in found(tmp_path, Board("chessboard", 6, 4), **options).warnings]
        assert codes == told


def test_sixteen_bits_and_colour_are_searched_too(tmp_path):
    gray = cv2.imread(str(write(tmp_path / "gray.png", BOARD)), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(tmp_path / "deep.png"), gray.astype(np.uint16) * 16)
    cv2.imwrite(str(tmp_path / "colour.png"), cv2.merge([gray, gray, gray]))
    report = found(tmp_path)
    assert [len(view.ids) for view in report.detections.views] == [30, 30, 30]


def test_nothing_is_searched_for_a_board_or_an_output_that_cannot_be(tmp_path):
    image = write(tmp_path / "a.png", BOARD)
    with pytest.raises(InvalidInput, match="inner corners is too small to be detected"):
        found(image, Board("chessboard", 9, 2))
    with pytest.raises(InvalidInput, match=r"did you mean DICT_4X4_50\?"):
        found(image, replace(CHARUCO, dictionary="DICT_4X4_5"))
    with pytest.raises(InvalidInput, match=r"\.txt is not written; use \.csv, \.vnl"):
        found(image, output=tmp_path / "corners.txt")
    table = image.rename(tmp_path / "image.csv")
    with pytest.raises(InvalidInput, match="is an input and is not overwritten"):
        found(table, output=table)


def test_images_that_cannot_be_read_at_all_are_an_error(tmp_path):
    (tmp_path / "a.png").write_bytes(b"no image")
    with pytest.raises(FileError, match="unknown image format"):
        found(tmp_path)
    (tmp_path / "b.png").write_bytes(b"no image")
    with pytest.raises(FileError, match="none of 2 images can be read; "):
        found(tmp_path)


def test_the_document_says_what_became_of_every_image(tmp_path):
    write(tmp_path / "a.png", BOARD)
    write_wall(tmp_path / "b.png")
    told = document(found(tmp_path), tmp_path / "corners.csv")
    assert told["board"] == {"type": "chessboard", "inner_corners": [6, 5], "square_mm": 30.0}
    assert [(image["corners"], image["reason"]) for image in told["images"]] == [(30, None), (0, "no chessboard found")]
