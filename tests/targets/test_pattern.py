"""The drawing of a board is the one OpenCV prints."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.targets.board import Board, parse_board
from camcal.targets.board_types import dotted_squares
from camcal.targets.pattern import pattern_of

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


CELLS = 8  # pixels of a tag's cell


def picture(board, pixels):
    """Return the drawing (H, W) uint8 at so many pixels a metre, upright, and where the board's points are in it."""
    pattern = pattern_of(board)
    lines = np.array([pattern.x[0], pattern.y[0]])
    width, height = ((axis[-1] - axis[0]) * pixels for axis in (pattern.x, pattern.y))
    x, y = np.meshgrid(np.arange(int(width)) + 0.5, np.arange(int(height)) + 0.5)
    places = np.column_stack([x.ravel(), y.ravel()]) / pixels + lines
    ink = pattern.ink_at(places)
    for u, v, radius, shade in pattern.discs:
        ink = np.where(np.hypot(places[:, 0] - u, places[:, 1] - v) < radius, shade, ink)
    image = (255 * ink.reshape(x.shape)).astype(np.uint8)
    corners = (board.points()[:, :2] - lines) * pixels - 0.5
    if board.z_sign > 0:
        return image, corners
    return np.ascontiguousarray(image[::-1]), corners * [1, -1] + [0, len(image) - 1]


@pytest.mark.parametrize("family", ["tag36h11", "tag25h9"])
def test_the_tags_of_an_aprilgrid_are_read_by_opencv_where_kalibr_has_them(family):
    """OpenCV draws AprilTags upside down, so its first corner is Kalibr's second and they run the other way round."""
    board = parse_board(f"aprilgrid:4x3:100mm:0.3:{family}")
    board = replace(board, first_marker=5)
    image, corners = picture(board, 10 * CELLS / 0.1)
    words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{family.removeprefix('tag')}"))
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    found, ids, _ = cv2.aruco.ArucoDetector(words, parameters).detectMarkers(image)
    assert sorted(ids.ravel()) == list(range(5, 17))
    order = np.argsort(ids.ravel())
    seen = np.array([tag.reshape(4, 2) for tag in found])[order][:, [1, 0, 3, 2]]
    assert np.abs(seen.reshape(-1, 2) - corners).max() < 2  # pixels: OpenCV's outlines lie beside the edge


def test_black_squares_fill_the_corners_between_and_around_tags():
    board = parse_board("aprilgrid:3x2:100mm:0.3")
    pattern = pattern_of(board)
    beside = 0.015  # half of the gap of 30 mm
    crossings = np.array([[0.13 * x - beside, 0.13 * y - beside] for x in range(4) for y in range(3)])
    assert pattern.ink_at(crossings).tolist() == [0] * 12
    gaps = np.array([[0.13 * x - beside, 0.13 * y + 0.05] for x in range(4) for y in range(2)])
    assert pattern.ink_at(gaps).tolist() == [1] * 8
    gaps = np.array([[0.13 * x + 0.05, 0.13 * y - beside] for x in range(3) for y in range(3)])
    assert pattern.ink_at(gaps).tolist() == [1] * 9
    border = np.array([[x, y] for x in (0.005, 0.015, 0.085, 0.095) for y in (0.005, 0.055, 0.095)])
    assert pattern.ink_at(border).tolist() == [0] * 12


@pytest.mark.parametrize("form", ["9x6", "8x6", "7x7", "14x9"])
def test_the_dots_of_a_chessboard_are_found_by_opencv(form):
    board = parse_board(f"chessboard:{form}:25mm:dots")
    image, corners = picture(board, 40 / 0.025)
    image = cv2.GaussianBlur(image, (0, 0), 1.0)
    flags = cv2.CALIB_CB_MARKER | cv2.CALIB_CB_LARGER
    found, places, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
    assert found
    near = np.linalg.norm(np.reshape(places, (-1, 1, 2)) - corners, axis=2)
    squares = np.array(np.divmod(near.argmin(axis=1), board.columns)).T[:, ::-1]  # column, row of the corner
    black = [tuple(place) for place in squares[meta.ravel() == 4].tolist()]
    white = {tuple(place) for place in squares[meta.ravel() == 3].tolist()}
    # OpenCV names a square by the corner at its top left in the order it found them in, which may be any of the four
    dots = [(column - 0.5, row - 0.5) for row, column in dotted_squares(board.columns, board.rows)]
    assert (len(black), len(white)) == (1, 2)
    for (column, row), of in [(black[0], dots[:1]), *((place, dots[1:]) for place in white)]:
        assert min(max(abs(column - x), abs(row - y)) for x, y in of) == 0.5


def test_circles_of_unknown_diameter_cannot_be_drawn():
    with pytest.raises(InvalidInput, match="grid of 10x8 circles needs a diameter to be drawn"):
        pattern_of(parse_board("circles:10x8:25mm"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("aprilgrid:30x30:20mm:0.3", "the board needs markers 0 to 899, tag36h11 ends at 586"),
        ("aprilgrid:3x3:20mm:0.3:tag36h12", "did you mean tag36h1[01]?"),
        ("charuco:30x30:20mm:14mm:DICT_4X4_50", "ends at 49"),
        ("charuco:4x3:20mm:14mm:DICT_4X4_51", "DICT_4X4_50"),
    ],
)
def test_a_dictionary_that_does_not_do_is_refused(text, message):
    with pytest.raises(InvalidInput, match=message):
        pattern_of(parse_board(text))
