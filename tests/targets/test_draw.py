"""Where a board stands on its page: true to scale, inside the margins, its white border clear; and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.targets.board import Board, parse_board
from camcal.targets.page import PAPERS, paper_named
from camcal.targets.printing import Footer, Sheet, ink_of, page_of

FOOTER = Footer("A title", "and small print that is a little longer", ruler=True)
BOARDS = (
    "chessboard:9x6:25mm",
    "chessboard:9x6:25mm:dots",
    "charuco:5x7:35mm:26mm:DICT_5X5_100",
    "charuco:5x8:30mm:22mm:DICT_4X4_50:legacy",
    "aprilgrid:6x6:22mm:0.3",
    "circles:8x6:25mm:15mm",
    "asymmetric_circles:4x11:20mm:15mm",
)
NANOMETRE = 1e-6  # mm: sums of floating point numbers of metres


def reach(shapes, discs):
    """Return the bounding box (left, top, right, bottom) of shapes and discs."""
    low = [shape.min(axis=0) for shape in shapes] + [disc[:2] - disc[2] for disc in discs]
    high = [shape.max(axis=0) for shape in shapes] + [disc[:2] + disc[2] for disc in discs]
    return np.concatenate([np.min(low, axis=0), np.max(high, axis=0)])


def parts(page, ink):
    """Return the bounding boxes of the board, of all that is in the footer, and of the page's middle part."""
    count = len(ink.outlines)
    words = [np.array([(text.x, text.y - 0.74 * text.size), (text.x + text.width, text.y)]) for text in page.texts]
    return reach(page.outlines[:count], page.discs), reach([*page.outlines[count:], *words], [])


@pytest.mark.parametrize("text", BOARDS)
def test_a_board_is_as_large_as_its_points_say(text):
    board = parse_board(text)
    ink = ink_of(board)
    box = reach(ink.outlines, ink.discs)
    assert box[:2] == pytest.approx([0, 0], abs=NANOMETRE)
    assert box[2:] == pytest.approx(ink.size, abs=NANOMETRE)
    if board.checker:
        assert ink.size == pytest.approx(1000 * np.add(board.extent, 2 * board.spacing))


@pytest.mark.parametrize(
    ("text", "finest"),
    [(BOARDS[0], 25), (BOARDS[1], 8.5), (BOARDS[2], 26 / 7), (BOARDS[4], 2.2), (BOARDS[5], 15)],
)
def test_the_finest_part_is_a_square_a_dot_a_cell_or_a_circle(text, finest):
    assert ink_of(parse_board(text)).finest == pytest.approx(finest)


@given(
    st.integers(2, 14), st.integers(2, 14), st.floats(3, 60), st.floats(0, 30),
    st.sampled_from([None, *PAPERS]), st.sampled_from([None, False, True]), st.booleans(),
)  # fmt: skip
def test_what_is_drawn_stays_between_the_margins_and_out_of_the_white_border(
    columns, rows, square_mm, margin, paper, landscape, ruler
):
    ink = ink_of(Board("chessboard", columns, rows, square_mm / 1000))
    footer = replace(FOOTER, ruler=ruler)
    try:
        page, lying = page_of(ink, footer, Sheet(paper, landscape, margin))
    except InvalidInput as error:
        follow(error.message, ink, footer, Sheet(paper, landscape, margin))
        return
    board, below = parts(page, ink)
    inside = np.array([margin, margin, lying.width - margin, lying.height - margin])
    assert landscape in (None, lying.landscape)
    assert board[2:] - board[:2] == pytest.approx(ink.size, abs=NANOMETRE)
    assert (board[:2] - ink.quiet >= inside[:2] - NANOMETRE).all()
    assert (board[2:] + ink.quiet <= inside[2:] + NANOMETRE).all()
    assert (below[:2] >= inside[:2] - NANOMETRE).all()
    assert (below[2:] <= inside[2:] + NANOMETRE).all()
    assert below[1] >= board[3] + ink.quiet - NANOMETRE


def follow(message, ink, footer, sheet):
    """Check that what an error advises will do."""
    advised = re.search(r"--paper ([A-Za-z0-9]+)", message)
    if advised is None:
        assert "--no-ruler" in message
        page_of(ink, replace(footer, ruler=False), replace(sheet, paper=paper_named("5000x5000mm")))
    else:
        page_of(ink, footer, replace(sheet, paper=paper_named(advised[1])))


def test_of_the_a_series_the_smallest_that_does_is_taken():
    names = {text: page_of(ink_of(parse_board(text)), FOOTER, Sheet())[1].described() for text in BOARDS}
    assert names["chessboard:9x6:25mm"] == "A4 landscape (297 x 210 mm)"
    assert names["charuco:5x7:35mm:26mm:DICT_5X5_100"] == "A4 portrait (210 x 297 mm)"
    assert page_of(ink_of(parse_board("aprilgrid:6x6:88mm:0.3")), FOOTER, Sheet())[1].name == "A0"


def test_a_smaller_board_that_is_advised_fits():
    ink = ink_of(parse_board("chessboard:9x6:30mm"))
    with pytest.raises(InvalidInput, match="--paper A3, or 26 mm in place of 30 mm"):
        page_of(ink, FOOTER, Sheet(paper_named("A4")))
    page_of(ink_of(parse_board("chessboard:9x6:26mm")), FOOTER, Sheet(paper_named("A4")))


def test_a_board_that_is_too_large_for_any_paper_is_refused_with_a_smaller_one():
    with pytest.raises(InvalidInput, match=r"above the footer: use 237\.4 mm in place of 3000 mm$"):
        page_of(ink_of(parse_board("chessboard:2x3:3m")), FOOTER, Sheet())
    assert page_of(ink_of(parse_board("chessboard:2x3:237.4mm")), FOOTER, Sheet())[1].name == "A0"


def test_the_ruler_is_a_hundred_millimetres_between_its_first_and_its_last_tick():
    shapes, texts = FOOTER.drawn(10.0, 200.0, 287.0)
    line, *ticks = shapes
    middles = [tick[:, 0].mean() for tick in ticks]
    assert np.ptp(line[:, 0]) == pytest.approx(100, abs=NANOMETRE)
    assert np.diff(middles) == pytest.approx(np.ones(100), abs=NANOMETRE)
    assert middles[0] == pytest.approx(line[0, 0], abs=NANOMETRE)
    assert [text.words for text in texts[:11]] == [str(number) for number in range(0, 101, 10)]


@pytest.mark.parametrize("room", [110, 150, 190, 250])
def test_lines_of_text_and_numbers_do_not_overlap(room):
    _, texts = FOOTER.drawn(0.0, 50.0, room)
    boxes = [(text.x, text.y - 0.74 * text.size, text.x + text.width, text.y) for text in texts]
    for number, (left, top, right, bottom) in enumerate(boxes):
        assert 0 <= left < right <= room
        for other in boxes[number + 1 :]:
            assert right <= other[0] or other[2] <= left or bottom <= other[1] or other[3] <= top


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("chessboard:9x6", "has no size for printing; give it as in chessboard:9x6"),
        ("charuco:5x7:0.75:DICT_4X4_50", "has no size for printing; give it as in charuco:9x7:30mm:22mm"),
        ("circles:8x6:25mm", "diameter"),
        ("charuco:30x30:20mm:14mm:DICT_4X4_50", "ends at 49"),
    ],
)
def test_a_board_that_cannot_be_drawn_is_refused_with_what_it_lacks(text, message):
    with pytest.raises(InvalidInput, match=message):
        ink_of(parse_board(text))


@pytest.mark.parametrize("text", ["A5", "100", "0x100mm", "100x-5", "100x99999mm", "1e3x100", ""])
def test_paper_that_is_none_is_refused(text):
    with pytest.raises(InvalidInput, match="paper"):
        paper_named(text)


@given(st.floats(1, 5000), st.floats(1, 5000))
def test_paper_of_any_size_is_taken_as_it_is_given(width, height):
    paper = paper_named(f"{width:.3f}x{height:.3f}mm")
    assert (paper.width, paper.height) == (round(width, 3), round(height, 3))


@pytest.mark.parametrize("margin", [-1.0, float("nan"), float("inf")])
def test_a_margin_that_is_none_is_refused(margin):
    with pytest.raises(InvalidInput, match="margin"):
        Sheet(margin=margin)
