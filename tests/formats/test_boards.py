"""Board files and short forms say the same; what contradicts itself is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import boards
from camcal.targets.board import METRES, Board, parse_board

SHORT_FORMS = [
    "chessboard:9x6",
    "chessboard:9x6:25mm",
    "charuco:9x7:30mm:22mm:DICT_5X5_100",
    "charuco:9x7:0.75:DICT_5X5_100:legacy",
    "charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000:current",
]


def refuse(tmp_path, content: str) -> str:
    path = tmp_path / "board.yaml"
    path.write_text(content)
    with pytest.raises(InvalidInput) as caught:
        boards.read(path)
    return str(caught.value).replace(str(path), path.name)


@pytest.mark.parametrize("form", SHORT_FORMS)
def test_short_form_and_file_lead_back_to_the_same_board(tmp_path, form):
    board = parse_board(form)
    assert boards.short_form(board) == form
    boards.write(tmp_path / "board.yaml", board)
    assert boards.read(tmp_path / "board.yaml") == board
    assert boards.load_board(str(tmp_path / "board.yaml")) == boards.load_board(form) == board


@given(
    st.builds(
        Board,
        st.just("chessboard"),
        st.integers(2, 1000),
        st.integers(2, 1000),
        st.one_of(st.none(), st.floats(1e-6, 100), st.integers(1, 5000).map(lambda n: n * METRES["mm"] / 10)),
    )
)
def test_the_short_form_of_any_chessboard_is_exact(board):
    assert parse_board(boards.short_form(board)) == board


@given(st.integers(1, 100_000), st.integers(1, 99), st.one_of(st.none(), st.booleans()))
def test_the_short_form_of_any_charuco_board_is_exact(tenths, share, legacy):
    square = tenths * METRES["mm"] / 10
    board = Board("charuco", 8, 6, square, square * share / 100, "DICT_4X4_50", legacy=legacy)
    assert parse_board(boards.short_form(board)) == board


@pytest.mark.parametrize(("unit", "value"), [("mm", 25.4), ("cm", 2.54), ("m", 0.0254), ("in", 1)])
def test_lengths_may_be_in_four_units(tmp_path, unit, value):
    path = tmp_path / "board.yaml"
    path.write_text(f"type: chessboard\ninner_corners: [9, 6]\nsquare_{unit}: {value}\n")
    assert boards.read(path).square == pytest.approx(0.0254, rel=1e-15)  # one rounding of the product


def test_charuco_sizes_count_squares_and_extra_keys_are_kept(tmp_path):
    path = tmp_path / "board.yaml"
    path.write_text(
        "type: charuco\nsquares: [9, 7]\nsquare_mm: 30\nmarker_ratio: 0.5\ndictionary: DICT_5X5_100\n"
        "first_marker_id: 12\nlegacy: true\n"
    )
    board = boards.read(path)
    assert (board.columns, board.rows, board.marker, board.first_marker, board.legacy) == (8, 6, 0.015, 12, True)
    boards.write(path, board)
    assert boards.read(path) == board
    with pytest.raises(InvalidInput, match="no short form"):
        boards.short_form(board)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("type: chess\ninner_corners: [9, 6]\n", "board.yaml:1: type: unknown board type 'chess'. Did you mean 'chess"),
        ("inner_corners: [9, 6]\n", "board.yaml:1: missing key 'type'"),
        ("type: chessboard\nsquares: [9, 6]\n", "board.yaml:2: squares: unknown key"),
        ("type: chessboard\ninner_corners: [9, 1]\n", "board.yaml:2: inner_corners[1]: 1 must be at least 2"),
        ("type: chessboard\ninner_corners: [9, 6]\nsquare: 25\n", "square: unknown key. Did you mean 'square_"),
        ("type: chessboard\ninner_corners: [9, 6]\nsquare_mm: 25mm\n", "square_mm: '25mm' is not a number"),
        ("type: chessboard\ninner_corners: [9, 6]\nsquare_mm: 25\nsquare_in: 1\n", "square_mm and square_in: give one"),
        ("type: charuco\nsquares: [9, 7]\ndictionary: D\n", "a ChArUco board needs its marker's size"),
        ("type: charuco\nsquares: [9, 7]\ndictionary: D\nmarker_mm: 3\n", "marker_mm without a square's length"),
        (
            "type: charuco\nsquares: [9, 7]\ndictionary: D\nsquare_mm: 3\nmarker_mm: 3\n",
            "the marker of a ChArUco board must be smaller",
        ),
        ("type: chessboard\ninner_corners: [9, 2000]\n", "more than the limit of 1000 a side"),
    ],
)
def test_a_board_that_cannot_be_is_refused_with_its_line(tmp_path, content, expected):
    assert expected in refuse(tmp_path, content)


def test_a_missing_board_file_is_a_file_error():
    with pytest.raises(FileError, match="no such file"):
        boards.load_board("nowhere/board.yaml")
