"""Board files and short forms say the same; what contradicts itself is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import FileError, InvalidInput
from camcal.formats import boards, documents, emit
from camcal.formats.boards import short_form
from camcal.targets.board import Board, parse_board
from camcal.targets.board_types import METRES

SHORT_FORMS = [
    "chessboard:9x6",
    "chessboard:9x6:25mm",
    "charuco:9x7:30mm:22mm:DICT_5X5_100",
    "charuco:9x7:0.75:DICT_5X5_100:legacy",
    "charuco:8x8:25.4mm:19.05mm:DICT_4X4_1000:current",
    "chessboard:9x6:dots",
    "chessboard:9x6:25mm:dots",
    "aprilgrid:6x6:88mm:0.3",
    "aprilgrid:6x4:0.25",
    "aprilgrid:6x6:35mm:0.2857:tag25h9",
    "circles:10x8",
    "circles:10x8:0.6",
    "circles:10x8:25mm",
    "circles:10x8:25mm:15mm",
    "asymmetric_circles:4x11",
    "asymmetric_circles:4x11:1.2",
    "asymmetric_circles:4x11:20mm:15mm",
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
    assert short_form(board) == form
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
    assert parse_board(short_form(board)) == board


@given(st.integers(1, 100_000), st.integers(1, 99), st.one_of(st.none(), st.booleans()))
def test_the_short_form_of_any_charuco_board_is_exact(tenths, share, legacy):
    square = tenths * METRES["mm"] / 10
    board = Board("charuco", 8, 6, square, square * share / 100, "DICT_4X4_50", legacy=legacy)
    assert parse_board(short_form(board)) == board


@given(
    st.sampled_from(["circles", "asymmetric_circles"]),
    st.one_of(st.none(), st.floats(1e-3, 100)),  # with the smallest share the diameter is 1 µm, the least there is
    st.one_of(st.none(), st.floats(1e-3, 0.999)),
)
def test_the_short_form_of_any_grid_of_circles_is_exact(kind, spacing, share):
    diameter = None if share is None else share * (spacing or 1.0)
    if spacing is not None and diameter is not None:
        spacing, diameter = round(spacing, 9), round(diameter, 12)  # so that mm are not longer than a number can be
        diameter = max(diameter, 1e-6)
    board = Board(kind, 4, 11, spacing, diameter=diameter)
    assert parse_board(short_form(board)) == board


@given(st.one_of(st.none(), st.integers(1, 100_000)), st.integers(1, 9999))
def test_the_short_form_and_the_file_of_any_aprilgrid_are_exact(tenths, spacing):
    size = "" if tenths is None else f"{tenths / 10}mm:"
    board = parse_board(f"aprilgrid:6x6:{size}{spacing / 1000}")
    assert parse_board(short_form(board)) == board
    assert boards.from_block(boards.block(board)) == board


LENGTHS = st.integers(1, 20_000).map(lambda tenths: f"{tenths / 10}mm")
SHARES = st.integers(1, 99).map(lambda share: f"{share / 100}")
ANY_FORM = st.one_of(
    st.builds(
        "chessboard:{}x{}:{}{}".format, st.integers(4, 30), st.integers(4, 30), LENGTHS, st.sampled_from(["", ":dots"])
    ),
    st.builds("charuco:{}x{}:{}:DICT_5X5_100".format, st.integers(3, 30), st.integers(3, 30), SHARES),
    st.builds("aprilgrid:{}x{}:{}:{}".format, st.integers(1, 30), st.integers(1, 30), LENGTHS, SHARES),
    st.builds("circles:{}x{}:{}".format, st.integers(2, 30), st.integers(2, 30), st.one_of(LENGTHS, SHARES)),
    st.builds("asymmetric_circles:{}x{}:{}".format, st.integers(2, 30), st.integers(2, 30), st.one_of(LENGTHS, SHARES)),
)


@given(ANY_FORM)
def test_the_file_of_any_board_holds_that_board(form):
    board = parse_board(form)
    document = documents.parse(emit.document(boards.block(board)), "board.yaml", boards.check)
    assert boards.from_block(document.data) == board
    assert parse_board(short_form(board)) == board


def test_an_aprilgrid_of_any_pitch_comes_back_to_the_last_bit():
    board = Board("aprilgrid", 6, 6, np.nextafter(0.1144, 1), 0.088, "tag36h11")
    assert parse_board(short_form(board)).square == pytest.approx(
        board.square, rel=3e-16
    )  # one rounding of the product


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
        short_form(board)


def test_an_aprilgrid_has_a_family_and_a_first_tag(tmp_path):
    path = tmp_path / "board.yaml"
    path.write_text("type: aprilgrid\ntags: [6, 4]\ntag_mm: 88\nspacing_ratio: 0.3\nfamily: tag25h9\nfirst_tag_id: 5\n")
    board = boards.read(path)
    assert (board.dictionary, board.first_marker, board.marker) == ("tag25h9", 5, 0.088)
    boards.write(path, board)
    assert boards.read(path) == board


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
        ("type: charuco\nsquares: [9, 7]\ndictionary: D\nmarker_mm: 3\n", "marker_mm without the length of a square"),
        (
            "type: charuco\nsquares: [9, 7]\ndictionary: D\nsquare_mm: 3\nmarker_mm: 3\n",
            "the marker of a ChArUco board must be smaller",
        ),
        ("type: chessboard\ninner_corners: [9, 2000]\n", "more than the limit of 1000 a side"),
        (
            "type: chessboard\ninner_corners: [3, 3]\ndots: true\n",
            "inner corners is too small for three dots (minimum 4 × 3)",
        ),
        ("type: aprilgrid\ntags: [6, 6]\ntag_mm: 88\n", "missing key 'spacing_ratio'"),
        ("type: aprilgrid\ntags: [6, 6]\ntag_mm: 88\nspacing_ratio: 0\n", "spacing_ratio: 0 must be > 0"),
        ("type: aprilgrid\ntags: [6, 6]\nsquare_mm: 88\nspacing_ratio: 0.3\n", "square_mm: unknown key"),
        ("type: circles\ncircles: [9, 1]\n", "board.yaml:2: circles[1]: 1 must be at least 2"),
        (
            "type: circles\ncircles: [9, 7]\ndiameter_mm: 3\n",
            "diameter_mm without the length of a pitch: add pitch_mm, or",
        ),
        ("type: circles\ncircles: [9, 7]\npitch_mm: 3\ndiameter_mm: 3\n", "give a smaller diameter"),
        (
            "type: circles\ncircles: [9, 7]\npitch_mm: 3\ndiameter_mm: 2\ndiameter_ratio: 0.5\n",
            "diameter_ratio: give one of them",
        ),
    ],
)
def test_a_board_that_cannot_be_is_refused_with_its_line(tmp_path, content, expected):
    assert expected in refuse(tmp_path, content)


def test_a_missing_board_file_is_a_file_error():
    with pytest.raises(FileError, match="no such file"):
        boards.load_board("nowhere/board.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("aprilgrid", "board 'aprilgrid': expected aprilgrid:6x6:88mm:0.3[:tag36h11] (tags, tag, spacing as a share"),
        ("aprilgrid:6x6", "an AprilGrid is aprilgrid:6x6:88mm:0.3"),
        ("aprilgrid:6x6:88mm", "'88mm' is not the spacing as a share of the tag"),
        ("aprilgrid:6x6:88:0.3", "'88' has no unit; write 88mm"),
        ("chessboard:9x6:0.025", "'0.025' has no unit; write 0.025m or 25mm if it is in metres"),
        ("aprilgrid:6x6:88mm:-0.3", "'-0.3' is not the spacing as a share of the tag, such as 0.3"),
        ("aprilgrid:6x6:-1", "'-1' is not the spacing"),
        ("aprilgrid:6x6:1e-20", "tags overlap: give a positive spacing"),
        ("aprilgrid:6x6:88mm:nan", "'nan' is not the spacing as a share of the tag"),
        ("circles:10x8:25mm:15mm:2mm", "too many parts; a grid of circles is circles:10x8"),
        ("circles:10x8:25mm:15", "'15' has no unit; write 15mm"),
        ("circles:10x8:wide", "'wide' is not a length with its unit or the diameter's share"),
        ("circles:10x8:25mm:25mm", "circles overlap: give a smaller diameter"),
        ("chessboard:9x6:dots:25mm", "too many parts"),
        ("circle:10x8", "board 'circle:10x8': did you mean 'circles:10x8'?"),
        ("chesboard:9x6:25mm", "did you mean 'chessboard:9x6:25mm'?"),
        ("door:10x8", "expected chessboard:9x6"),
        ("charuco:9x7:30mm:22mm", "a ChArUco board is charuco:9x7:30mm:22mm:DICT_5X5_100"),
        ("aprilgrid:99999999999x6:0.3", "is not a size"),
    ],
)
def test_a_short_form_that_is_none_says_which_part(text, message):
    with pytest.raises(InvalidInput) as caught:
        boards.load_board(text)
    assert message in str(caught.value)


@pytest.mark.slow
@given(st.text(max_size=40) | st.from_regex(r"(aprilgrid|circles|charuco|chessboard)(:[0-9x.mdn-]{0,6}){0,4}"))
def test_any_text_is_a_board_or_refused(text):
    try:
        board = parse_board(text)
    except InvalidInput:
        return
    assert board.count >= 4
