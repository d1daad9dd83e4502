"""Messages about boards of every type after a search: warnings, and why there is nothing."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.targets.board import parse_board
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.which_board import OtherBoard, board_warnings, nothing_found, symmetry_warnings

AMBIGUOUS = "corner ids, and poses of the board, may be turned by that from view to view"
NOTHING = BoardDetection("a.png", (640, 480), reason="nothing seen")


def instead(other):
    """Return the view that shows another board."""
    return replace(NOTHING, other=other)


@pytest.mark.parametrize(
    ("form", "texts"),
    [
        ("chessboard:9x6", ["square size unknown: lengths are in squares; give it with --board"]),
        ("chessboard:8x6:25mm:dots", []),
        ("aprilgrid:6x6:88mm:0.3", []),
        ("aprilgrid:6x6:0.3", ["tag size unknown: lengths are in tag spacings; give it with --board"]),
        (
            "circles:10x8:25mm",
            [f"a 10x8 board is symmetric under rotation by 180°: {AMBIGUOUS}"],
        ),
        ("circles:8x8:25mm", [f"a 8x8 board is symmetric under rotation by 90°: {AMBIGUOUS}"]),
        ("asymmetric_circles:4x11:20mm", []),
        (
            "asymmetric_circles:4x4",
            [
                "circle spacing unknown: lengths are in row spacings; give it with --board",
                f"a 4x4 board is symmetric under rotation by 180°: {AMBIGUOUS}",
            ],
        ),
    ],
)
def test_unknown_sizes_and_symmetries_are_told_in_the_words_of_the_board(form, texts):
    board = parse_board(form)
    found = (*board_warnings([NOTHING], board, board), *symmetry_warnings(board))
    assert [each.text for each in found] == texts


@pytest.mark.parametrize(
    ("form", "message"),
    [
        (
            "aprilgrid:6x6:88mm:0.3",
            "no AprilGrid of 6x6 tags in any of 2 images (2 times: nothing seen); check the number",
        ),
        (
            "circles:10x8",
            "no grid of 10x8 circles in any of 2 images (2 times: nothing seen); check the number of circles",
        ),
        ("asymmetric_circles:4x11", "(those in one row, then the rows), and the images"),
        ("chessboard:8x6:dots", "no chessboard of 8x6 inner corners and three dots in any of 2 images"),
    ],
)
def test_a_board_that_is_nowhere_is_named_with_what_to_check(form, message):
    assert message in str(nothing_found([NOTHING, NOTHING], parse_board(form)))


def test_another_size_that_is_proposed_keeps_the_squares_and_the_dots():
    asked = parse_board("chessboard:10x7:25mm:dots")
    error = nothing_found([instead(asked.of_size(9, 6))], asked)
    assert str(error).endswith("sizes count inner corners, not squares: use --board chessboard:9x6:25mm:dots")


@pytest.mark.parametrize(
    ("asked", "shown", "message"),
    [
        (
            "circles:8x5:25mm:15mm",
            "circles:7x5:25mm:15mm",
            "3 of 3 images, but a grid of 7x5 circles in 2; use --board circles:7x5:25mm:15mm",
        ),
        (
            "circles:8x5:25mm",
            "asymmetric_circles:7x13",
            "3 of 3 images, but an asymmetric grid of 7x13 circles in 2; use --board asymmetric_circles:7x13",
        ),
    ],
)
def test_another_grid_of_circles_is_proposed_as_a_board(asked, shown, message):
    other = parse_board(shown)
    text = str(nothing_found([instead(other), NOTHING, instead(other)], parse_board(asked)))
    assert text == f"no grid of 8x5 circles in {message}"


@pytest.mark.parametrize(
    ("asked", "shown", "differences", "form"),
    [
        ("8x8:25.4mm:15mm:DICT_4X4_50", "8x8:25.4mm:19mm:DICT_4X4_50", "markers of 19 mm, not 15 mm", None),
        (
            "9x8:0.6:DICT_4X4_50",
            "8x8:0.75:DICT_4X4_50",
            "8x8 squares, not 9x8, markers of 0.75 of a square, not 0.6",
            None,
        ),
        ("9x8:5mm:3mm:DICT_5X5_50", "9x8:5mm:3mm:DICT_4X4_50", "DICT_4X4_50, not DICT_5X5_50", None),
        (
            "8x8:5mm:3mm:DICT_4X4_50:legacy",
            "8x8:5mm:3mm:DICT_4X4_50:current",
            "the current pattern (OpenCV since",
            None,
        ),
        ("8x8:5mm:3mm:DICT_4X4_50", "8x8:5mm:3mm:DICT_4X4_50", "marker ids from 17, not 0", 17),
    ],
)
def test_another_charuco_board_is_proposed_with_what_differs(asked, shown, differences, form):
    board = replace(parse_board(f"charuco:{shown}"), first_marker=form or 0)
    text = str(OtherBoard(board, 2, 3).error([NOTHING] * 4, parse_board(f"charuco:{asked}")))
    assert f"in 4 of 4 images: 2 of 3 tested images show {differences}" in text
    end = f"with a board file: charuco:{shown}, first_marker_id: {form}" if form else f"charuco:{shown}"
    assert text.endswith(f"; use --board {end}")


@pytest.mark.parametrize(("pattern", "parts"), [((6, 4), False), ((6, 4), True), ((11, 4), False)])
def test_a_smaller_pattern_may_be_a_part_unless_parts_count_already(pattern, parts):
    asked = parse_board("chessboard:9x6:25mm")
    error = nothing_found([instead(asked.of_size(*pattern))], asked, parts=parts)
    assert ("or --partial" in str(error)) == (pattern == (6, 4) and not parts)


@pytest.mark.parametrize("form", ["aprilgrid:2x2:88mm:0.3", "circles:3x3", "asymmetric_circles:3x3"])
def test_a_board_that_was_found_is_no_error(form):
    board = parse_board(form)
    seen = BoardDetection("b.png", (640, 480), np.arange(board.count), np.zeros((board.count, 2)))
    assert nothing_found([NOTHING, seen], board) is None
