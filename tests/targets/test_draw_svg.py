"""An SVG holds the page in millimetres."""

import re
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from printed import BOARDS, FOOTER, page_with

from camcal.targets.page import Page, rectangle, svg

SVG = {"svg": "http://www.w3.org/2000/svg"}


def parsed(page):
    return ET.fromstring(svg(page))


def test_an_svg_is_in_millimetres():
    root = parsed(page_with("chessboard:9x6:25mm"))
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == ("297mm", "210mm", "0 0 297 210")
    assert root.find("svg:title", SVG).text == FOOTER.title
    assert [text.text for text in root.findall("svg:text", SVG)][-2:] == [FOOTER.title, FOOTER.small]


@pytest.mark.parametrize("text", BOARDS)
def test_shapes_and_discs_are_those_of_the_page(text):
    page = page_with(text)
    root = parsed(page)
    paths = root.find("svg:path", SVG).get("d").split("M")[1:]
    assert len(paths) == len(page.outlines)
    for path, outline in zip(paths, page.outlines, strict=True):
        assert np.array(re.findall(r"[\d.]+", path), float) == pytest.approx(outline.ravel(), abs=1e-5)  # 10 nm
    circles = [[float(circle.get(key)) for key in ("cx", "cy", "r")] for circle in root.findall("svg:circle", SVG)]
    assert np.array(circles).reshape(-1, 3) == pytest.approx(page.discs[:, :3], abs=1e-5)


def test_discs_are_black_or_white():
    page = Page((10.0, 10.0), (rectangle(1, 1, 9, 9),), [(5, 5, 2, 1), (5, 5, 1, 0)], (), "dots")
    root = parsed(page)
    assert root.find("svg:path", SVG).get("fill") == "#000"
    assert [circle.get("fill") for circle in root.findall("svg:circle", SVG)] == ["#fff", "#000"]
