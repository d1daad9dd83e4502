"""Where the points of every type of board lie, and which turns of a board cannot be told apart."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.targets.board import Board, parse_board
from camcal.targets.board_types import BOARD_TYPES, dotted_squares
from camcal.targets.pattern import pattern_of

FORMS = [
    "chessboard:9x6:25mm",
    "chessboard:9x6:25mm:dots",
    "charuco:9x7:30mm:22mm:DICT_5X5_100",
    "aprilgrid:6x4:88mm:0.3",
    "circles:10x8:25mm:15mm",
    "asymmetric_circles:4x11:20mm:15mm",
]
SIZES = st.integers(2, 7)


def test_an_aprilgrid_has_the_points_of_kalibr():
    """Kalibr's corner grid: two corners a tag each way, the first at 0, then every tag one size and spacing further."""
    size, ratio, columns, rows = 0.088, 0.3, 6, 4
    points = parse_board("aprilgrid:6x4:88mm:0.3").points()
    for row in range(2 * rows):
        for column in range(2 * columns):
            x = (column // 2) * (1 + ratio) * size + (column % 2) * size
            y = (row // 2) * (1 + ratio) * size + (row % 2) * size
            tag = (row // 2) * columns + column // 2
            corner = {(0, 0): 0, (0, 1): 1, (1, 1): 2, (1, 0): 3}[row % 2, column % 2]  # lower left, counter-clockwise
            assert points[4 * tag + corner] == pytest.approx([x, y, 0], abs=1e-15)  # rounding of one product


def test_asymmetric_circles_are_those_of_opencv():
    points = parse_board("asymmetric_circles:4x11:20mm").points()
    wanted = [[(2 * column + row % 2) * 0.02, row * 0.02, 0] for row in range(11) for column in range(4)]
    np.testing.assert_allclose(points, wanted, atol=1e-15)  # rounding of one product


def test_a_grid_is_numbered_along_its_rows():
    board = parse_board("circles:10x8:25mm")
    assert board.points()[13] == pytest.approx([0.075, 0.025, 0])
    assert board.points()[1] == pytest.approx([0.025, 0, 0])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("known", [True, False])
def test_points_begin_at_the_origin_and_fill_the_extent(form, known):
    board = parse_board(form)
    part = {"marker": board.marker, "diameter": board.diameter}
    scaled = {name: length / board.spacing for name, length in part.items() if length is not None}
    board = board if known else replace(board, square=None, **scaled)
    points = board.points()
    assert points.shape == (board.count, 3)
    assert points.min(axis=0).tolist() == [0, 0, 0]
    assert points.max(axis=0).tolist() == [*board.extent, 0]
    assert board.unit == ("m" if known else "squares")


def picture(board, turns):
    """Return the ink (K, K) of a board's drawing about its middle, turned by quarter turns."""
    pattern = pattern_of(board)
    reach = max(board.extent) / 2 + 0.2971 * board.spacing  # so that samples lie on no edge
    places = np.linspace(-reach, reach, 120)
    x, y = np.meshgrid(places, places)
    for _ in range(turns):
        x, y = -y, x
    flat = np.column_stack([x.ravel(), y.ravel()]) + np.array(board.extent) / 2
    rim = [np.clip(flat[:, k], axis[0] + 1e-9, axis[-1] - 1e-9) for k, axis in enumerate((pattern.x, pattern.y))]
    ink = pattern.ink_at(np.column_stack(rim))
    for u, v, radius, shade in pattern.discs:
        ink = np.where(np.hypot(flat[:, 0] - u, flat[:, 1] - v) < radius, shade, ink)
    return ink


@pytest.mark.slow
@given(st.sampled_from(["circles", "asymmetric_circles", "aprilgrid", "dotted", "odd chessboard"]), SIZES, SIZES)
def test_a_board_has_the_symmetries_that_its_drawing_has(kind, columns, rows):
    if kind in ("circles", "asymmetric_circles"):
        board = Board(kind, columns, rows, 1.0, diameter=0.6)
    elif kind == "aprilgrid":
        board = parse_board(f"aprilgrid:{columns}x{rows}:10mm:0.3")
    elif kind == "dotted":
        board = Board("chessboard", columns + 2, rows + 1, 1.0, dots=True)
    else:
        board = Board("chessboard", columns, columns + 2 * rows - 1, 1.0)
    turned = [turns for turns in range(4) if np.array_equal(picture(board, 0), picture(board, turns))]
    assert len(board.symmetries()) == len(turned)


@given(st.sampled_from(["chessboard", "circles", "asymmetric_circles"]), SIZES, SIZES)
def test_symmetries_are_turns_of_the_points_and_no_reflections(kind, columns, rows):
    board = Board(kind, columns, rows, 0.02)
    points = board.points()[:, :2] - np.array(board.extent) / 2
    flat = points @ [1, 1j]
    angles = set()
    for permutation in board.symmetries():
        ratio = flat[permutation][flat != 0] / flat[flat != 0]
        np.testing.assert_allclose(ratio, ratio[0], atol=1e-9)  # the same rotation for all: rounding only
        angles.add(round(float(np.angle(ratio[0], deg=True))) % 360)
    assert len(angles) == len(board.symmetries())
    assert board.symmetries()[0].tolist() == list(range(board.count))


@given(st.integers(2, 40), st.integers(2, 40))
def test_three_dots_lie_within_the_board_the_first_on_white(columns, rows):
    dots = dotted_squares(columns, rows)
    room = min(columns, rows) >= 3 and max(columns, rows) >= 4
    assert len(dots) == (3 if room else 0)
    if room:
        assert [sum(place) % 2 for place in dots] == [1, 0, 0]  # the square in the corner is black
        assert all(1 <= row <= rows - 1 and 1 <= column <= columns - 1 for row, column in dots)
        middle = np.array([rows, columns]) / 2
        assert np.abs(np.array(dots[0]) - middle).max() <= 1.5


def test_a_board_without_room_for_dots_is_refused():
    with pytest.raises(InvalidInput, match="a chessboard of 3 × 3 inner corners is too small for three dots"):
        parse_board("chessboard:3x3:25mm:dots")


WORDS = (
    "chessboard of 9x6 inner corners",
    "chessboard of 9x6 inner corners and three dots",
    "ChArUco board of 9x7 squares",
    "AprilGrid of 6x4 tags",
    "grid of 10x8 circles",
    "asymmetric grid of 4x11 circles",
)


@pytest.mark.parametrize(("form", "words"), list(zip(FORMS, WORDS, strict=True)))
def test_a_board_is_called_by_what_one_counts_on_it(form, words):
    assert parse_board(form).words == words


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"type": "checkers", "columns": 9, "rows": 6}, "board type 'checkers' is unknown; use chessboard, charuco"),
        ({"type": "chessboard", "columns": 9, "rows": 6, "diameter": 0.1}, "type chessboard has no diameter"),
        ({"type": "circles", "columns": 9, "rows": 6, "dots": True}, "type circles has no dots"),
        ({"type": "circles", "columns": 9, "rows": 1}, "at least 2 × 2 circles, found 9 × 1"),
        (
            {"type": "circles", "columns": 9, "rows": 6, "square": 0.02, "diameter": 0.02},
            "circles overlap: give a smaller diameter",
        ),
        ({"type": "aprilgrid", "columns": 6, "rows": 0, "marker": 0.5, "dictionary": "tag36h11"}, "1 × 1 tags"),
        (
            {"type": "aprilgrid", "columns": 6, "rows": 6, "marker": 1.0, "dictionary": "tag36h11"},
            "tags overlap: give a positive spacing",
        ),
        ({"type": "aprilgrid", "columns": 6, "rows": 6, "dictionary": "tag36h11"}, "needs the side of a tag"),
        ({"type": "circles", "columns": 9, "rows": 6, "square": float("nan")}, "must be positive"),
        ({"type": "circles", "columns": 9, "rows": 6, "square": 0.5e-6}, r"from 1 µm to 100 m"),
        ({"type": "circles", "columns": 9, "rows": 6, "square": 200.0}, r"from 1 µm to 100 m"),
        ({"type": "asymmetric_circles", "columns": 4, "rows": 1001}, "limit of 1000 a side"),
    ],
)
def test_a_board_that_cannot_be_is_refused(fields, message):
    with pytest.raises(InvalidInput, match=message):
        Board(**fields)


def test_asymmetric_circles_may_be_wider_than_the_distance_of_rows():
    assert Board("asymmetric_circles", 4, 11, 0.02, diameter=0.025).diameter == 0.025  # neighbours are √2 · 20 mm apart


def test_every_type_has_a_short_form_and_words():
    assert {parse_board(form).type for form in FORMS} == set(BOARD_TYPES)
