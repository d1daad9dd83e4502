"""The drawing of a board is the one OpenCV prints."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.simulate.pattern import pattern_of
from camcal.targets.board import Board, parse_board

MM = 1e-3


def sampled(pattern, width_mm, height_mm, per_mm):
    """Return the ink (height, width) around the origin of a board at some dots per millimetre, the border left out."""
    x, y = ((np.arange(size * per_mm) + 0.5) * MM / per_mm for size in (width_mm, height_mm))
    return lambda square: pattern.ink[
        np.searchsorted(pattern.y, y - square)[:, None] - 1, np.searchsorted(pattern.x, x - square) - 1
    ]


@pytest.mark.parametrize("squares", [(9, 7), (8, 6), (7, 8), (8, 7)])
@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("dictionary", ["DICT_5X5_100", "DICT_APRILTAG_36h11"])
def test_a_charuco_board_is_drawn_as_by_opencv(squares, legacy, dictionary):
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = words.markerSize + 2
    side, marker = cells + 8, cells  # so that one cell is one millimetre
    printed = cv2.aruco.CharucoBoard(squares, float(side), float(marker), words)
    printed.setLegacyPattern(legacy)
    image = printed.generateImage((squares[0] * side, squares[1] * side))
    board = Board("charuco", squares[0] - 1, squares[1] - 1, side * MM, marker * MM, dictionary, legacy=legacy)
    ours = sampled(pattern_of(board), squares[0] * side, squares[1] * side, 1)(side * MM)
    assert np.array_equal(255 * ours, image)


def test_markers_count_from_the_first_one():
    board = parse_board("charuco:4x3:20mm:14mm:DICT_4X4_50")
    shifted = pattern_of(replace(board, first_marker=1))
    # Six white squares: the second marker of the first board is the first of the other.
    assert not np.array_equal(shifted.ink, pattern_of(board).ink)
    step = 8  # lines per square: 6 cells and the white on both sides
    assert np.array_equal(
        shifted.ink[1 : 1 + step, 1 + step : 1 + 2 * step],
        pattern_of(board).ink[1 : 1 + step, 1 + 3 * step : 1 + 4 * step],
    )


def test_a_chessboard_begins_with_a_black_square_outside_its_first_corner():
    pattern = pattern_of(Board("chessboard", 3, 2, 0.01))
    assert pattern.ink.tolist() == [
        [1, 1, 1, 1, 1, 1],
        [1, 0, 1, 0, 1, 1],
        [1, 1, 0, 1, 0, 1],
        [1, 0, 1, 0, 1, 1],
        [1, 1, 1, 1, 1, 1],
    ]
    assert pattern.x == pytest.approx([-0.0175, -0.01, 0, 0.01, 0.02, 0.03, 0.0375])
    assert pattern.y == pytest.approx([-0.0175, -0.01, 0, 0.01, 0.02, 0.0275])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("charuco:30x30:20mm:14mm:DICT_4X4_50", "ends at 49"),
        ("charuco:4x3:20mm:14mm:DICT_4X4_51", "DICT_4X4_50"),
    ],
)
def test_a_dictionary_that_does_not_do_is_refused(text, message):
    with pytest.raises(InvalidInput, match=message):
        pattern_of(parse_board(text))
