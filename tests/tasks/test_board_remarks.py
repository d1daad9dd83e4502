"""What is said of boards of every type after a search: remarks, and why there is nothing."""

import numpy as np
import pytest

from camcal.targets.board import Detection, parse_board
from camcal.tasks.calibration.board_remarks import nothing_found, remarks

NOTHING = Detection.nothing("a.png", (640, 480), "nothing seen")


@pytest.mark.parametrize(
    ("form", "notes"),
    [
        ("chessboard:9x6", ["the size of a square is not given: lengths are in squares"]),
        ("chessboard:8x6:25mm:dots", []),
        ("aprilgrid:6x6:88mm:0.3", []),
        ("aprilgrid:6x6:0.3", ["the size of a tag is not given: lengths are in squares, 1 from tag to tag"]),
        ("circles:10x8:25mm", ["a 10x8 board looks the same after half a turn: numbering may differ by views"]),
        ("circles:8x8:25mm", ["a 8x8 board looks the same after a quarter turn: numbering may differ by views"]),
        ("asymmetric_circles:4x11:20mm", []),
        (
            "asymmetric_circles:4x4",
            [
                "the distance of the circles is not given: lengths are in squares, 1 from row to row",
                "a 4x4 board looks the same after half a turn: numbering may differ by views",
            ],
        ),
    ],
)
def test_unknown_sizes_and_symmetries_are_told_in_the_words_of_the_board(form, notes):
    board = parse_board(form)
    assert list(remarks([NOTHING], board, board)) == notes


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
        ("asymmetric_circles:4x11", "(those in one row, then the rows), or look at the images"),
        ("chessboard:8x6:dots", "no chessboard of 8x6 inner corners and three dots in any of 2 images"),
    ],
)
def test_a_board_that_is_nowhere_is_named_with_what_to_check(form, message):
    assert message in str(nothing_found([NOTHING, NOTHING], [None, None], parse_board(form)))


def test_a_checker_pattern_beside_another_type_of_board_is_not_proposed():
    error = nothing_found([NOTHING], [(9, 6)], parse_board("aprilgrid:6x6:88mm:0.3"))
    assert "checker" not in str(error)


def test_another_size_that_is_proposed_keeps_the_dots():
    error = nothing_found([NOTHING], [(9, 6)], parse_board("chessboard:10x7:25mm:dots"))
    assert str(error).endswith("sizes count inner corners, not squares: use --board chessboard:9x6:dots")


@pytest.mark.parametrize(("pattern", "parts"), [((6, 4), False), ((6, 4), True), ((11, 4), False)])
def test_a_smaller_pattern_may_be_a_part_unless_parts_count_already(pattern, parts):
    error = nothing_found([NOTHING], [pattern], parse_board("chessboard:9x6:25mm"), parts=parts)
    assert ("or --partial" in str(error)) == (pattern == (6, 4) and not parts)


@pytest.mark.parametrize("form", ["aprilgrid:2x2:88mm:0.3", "circles:3x3", "asymmetric_circles:3x3"])
def test_a_board_that_was_found_is_no_error(form):
    board = parse_board(form)
    seen = Detection("b.png", (640, 480), np.arange(board.count), np.zeros((board.count, 2)))
    assert nothing_found([NOTHING, seen], [None, None], board) is None
