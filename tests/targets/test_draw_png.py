"""A PNG holds the page at its true size, every pixel as gray as ink covers it."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from printed import decoded, page_with

from camcal.errors import InvalidInput
from camcal.targets.board import parse_board
from camcal.targets.page import Page, Text, dots_per_mm, paper_named, png, rectangle, size_in_pixels
from camcal.targets.printing import ink_of, require_fine

NO_DISCS = np.zeros((0, 4))


def ink(page, dpi=254):
    """Return the share of ink (H, W) of every pixel."""
    return 1 - decoded(png(page, dpi)) / 255.0


def chunks(content):
    """Return the chunks of a PNG file by their names; every checksum must be right."""
    found, place = {}, 8
    while place < len(content):
        (length,), kind = struct.unpack_from(">I", content, place), content[place + 4 : place + 8]
        data = content[place + 8 : place + 8 + length]
        assert struct.unpack_from(">I", content, place + 8 + length)[0] == zlib.crc32(kind + data)
        found[kind] = data
        place += 12 + length
    return found


def test_a_png_says_how_large_it_is():
    found = chunks(png(page_with("chessboard:9x6:25mm"), 300))
    assert struct.unpack(">IIB", found[b"pHYs"]) == (11811, 11811, 1)  # pixels a metre: 300 dpi to 2e-6
    assert struct.unpack(">II", found[b"IHDR"][:8]) == (3508, 2480)


def test_squares_of_whole_pixels_have_no_gray_edges():
    board = ink(page_with("chessboard:9x6:25mm"))[: 10 * 195]
    assert set(np.unique(board)) == {0, 1}
    assert board.sum() == 35 * 250**2


@settings(max_examples=20)
@given(st.floats(20, 300), st.tuples(*[st.floats(1, 11)] * 4))
def test_every_pixel_is_as_gray_as_a_rectangle_covers_it(dpi, sides):
    left, top, width, height = sides
    page = Page((23.0, 23.0), (rectangle(left, top, left + width, top + height),), NO_DISCS, (), "rectangle")
    dark, scale = ink(page, dpi), dots_per_mm(dpi)
    across, down = (
        np.clip(np.minimum(end, places + 1) - np.maximum(start, places), 0, 1)
        for start, end, places in (
            (left * scale, (left + width) * scale, np.arange(dark.shape[1])),
            (top * scale, (top + height) * scale, np.arange(dark.shape[0])),
        )
    )
    assert np.abs(dark - np.outer(down, across)).max() <= 0.5 / 255 + 1e-9  # gray levels are whole


@pytest.mark.parametrize("radius", [1.0, 2.3, 11.0])
def test_a_disc_has_its_area_and_its_centre(radius):
    dark = ink(Page((40.0, 40.0), (), [(20.013, 18.027, radius, 0.0)], (), "disc"))
    rows, columns = np.indices(dark.shape) + 0.5
    assert dark.sum() == pytest.approx(np.pi * (10 * radius) ** 2, rel=1e-3)  # 16 chords a row, and rounding to 1/255
    centre = np.array([(columns * dark).sum(), (rows * dark).sum()]) / dark.sum()
    assert centre == pytest.approx([200.13, 180.27], abs=0.005)  # pixels


def test_black_is_black_where_shapes_overlap_and_white_discs_are_cut_out_of_it():
    page = Page((10.0, 10.0), (rectangle(1, 1, 9, 9), rectangle(2, 2, 9, 5)), [(5.0, 7.0, 1.5, 1.0)], (), "shapes")
    dark = ink(page)
    assert (dark[30, 30], dark[70, 50], dark[70, 20], dark[95, 95]) == (1, 0, 1, 0)
    assert dark[50:].sum() == pytest.approx(40 * 80 - np.pi * 15**2, rel=1e-3)


def test_a_page_is_the_same_whatever_band_of_rows_a_shape_lies_in():
    tall = Page((10.0, 120.0), (rectangle(2, 3.33, 7, 118.2),), [(3.0, 51.2, 0.8, 1.0)], (), "tall")
    low = Page((10.0, 20.0), (), [(3.0, 11.2, 0.8, 0.0)], (), "low")
    # One gray level: a half of one is rounded either way.
    assert np.abs(ink(tall)[420:600, 25:35] - (1 - ink(low)[20:200, 25:35])).max() < 1.01 / 255


def test_text_is_as_wide_as_in_helvetica():
    text = Text(10.0, 12.0, 4.0, "chessboard:9x6:25mm")
    columns = np.flatnonzero((ink(Page((100.0, 20.0), (), NO_DISCS, (text,), "text")) > 0.5).any(axis=0))
    assert text.width == pytest.approx(40.46, abs=0.01)  # 10 115 of Adobe's units
    # In another font: its letters begin and end within half of a letter of where Helvetica's do.
    assert (columns[0], columns[-1]) == (pytest.approx(100, abs=10), pytest.approx(505, abs=10))


def test_a_resolution_that_loses_details_is_refused():
    charuco = ink_of(parse_board("charuco:5x7:35mm:26mm:DICT_5X5_100"))
    with pytest.raises(InvalidInput, match=r"3\.71 mm, has 2\.9 pixels; it takes 4: use 28 dpi or more"):
        require_fine(charuco, 20)
    require_fine(charuco, 28)


def test_a_picture_of_too_many_pixels_is_refused():
    page = page_with("chessboard:9x6:25mm", paper=paper_named("A0"))
    with pytest.raises(InvalidInput, match="at most 400 million"):
        size_in_pixels(page, 1200)
    with pytest.raises(InvalidInput, match="0 x 0 pixels"):
        size_in_pixels(page, 0.01)
