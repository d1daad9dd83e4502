"""A PDF holds the page at its true size, and nothing that differs from one run to the next."""

import re
from itertools import pairwise

import numpy as np
import pypdfium2
import pytest
from printed import BOARDS, DPI, FOOTER, decoded, page_with, rasterised

from camcal.targets.page import Page, pdf, png, rectangle

PAGE = page_with("chessboard:9x6:25mm")


def test_a_pdf_is_a_page_of_its_size_that_viewers_do_not_scale():
    content = pdf(PAGE)
    with pypdfium2.PdfDocument(content) as document:
        assert len(document) == 1
        assert document[0].get_size() == pytest.approx((297 * 72 / 25.4, 210 * 72 / 25.4), abs=2e-4)  # written to 1e-4
        assert document.get_metadata_value("Title") == FOOTER.title
        assert FOOTER.title in document[0].get_textpage().get_text_bounded()
    assert b"/PrintScaling /None" in content


def test_a_pdf_has_a_date_only_where_it_is_given_one():
    with pypdfium2.PdfDocument(pdf(PAGE)) as document:
        assert document.get_metadata_value("CreationDate") == ""
    with pypdfium2.PdfDocument(pdf(PAGE, "2026-01-31T12:30:00Z")) as document:
        assert document.get_metadata_value("CreationDate") == "D:20260131123000Z"


def test_the_table_of_a_pdf_says_where_its_objects_are():
    content = pdf(PAGE)
    start = int(re.search(rb"startxref\n(\d+)\n", content)[1])
    assert content[start:].startswith(b"xref\n0 7\n")
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n ", content), 1):
        assert content[int(offset) :].startswith(b"%d 0 obj\n" % number)
    stream = content.index(b"stream\n") + len(b"stream\n")
    length = int(re.search(rb"/Length (\d+)", content)[1])
    assert content[stream + length :].startswith(b"\nendstream")


def test_the_ruler_is_a_hundred_millimetres_in_points():
    page = Page((200.0, 100.0), FOOTER.drawn(50.0, 90.0, 120.0)[0], np.zeros((0, 4)), (), "ruler")
    shapes = [[float(x) for x in re.findall(rb"(\S+) \S+ [ml]\n", shape)] for shape in pdf(page).split(b"\nh\n")[:102]]
    line, *ticks = shapes
    middles = [(max(tick) + min(tick)) / 2 for tick in ticks]
    assert max(line) - min(line) == pytest.approx(283.4646, abs=1e-4)  # points, written to 1e-4
    assert middles[-1] - middles[0] == pytest.approx(283.4646, abs=1e-4)
    assert [right - left for left, right in pairwise(middles)] == pytest.approx([2.8346] * 100, abs=2e-4)


def test_ink_is_pure_black():
    assert set(re.findall(rb"^(.*) g$", pdf(PAGE), re.MULTILINE)) == {b"0"}
    assert b" rg" not in pdf(PAGE)


@pytest.mark.parametrize("text", BOARDS)
def test_a_pdf_shows_what_a_png_does(text):
    page = page_with(text)
    board = slice(None, round(DPI / 25.4 * (page.size[1] - 5 - 12)))  # above the footer, whose fonts differ
    difference = rasterised(pdf(page))[board].astype(float) - decoded(png(page, DPI))[board]
    # Coverage in gray levels: pdfium has 8 bits of it, and draws circles as polygons, up to 0.2 px inside of them.
    assert np.abs(difference).max() <= (50 if len(page.discs) else 4)


def test_white_discs_lie_on_the_black():
    page = Page((10.0, 10.0), (rectangle(1, 1, 9, 9),), [(5.0, 5.0, 2.0, 1.0)], (), "dot")
    image = rasterised(pdf(page), 254)
    assert (image[50, 50], image[50, 20], image[2, 2]) == (255, 0, 255)
