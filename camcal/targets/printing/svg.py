"""A page as an SVG file in millimetres."""

from collections.abc import Iterator
from xml.sax.saxutils import escape

from camcal.arrays import Array
from camcal.targets.printing.page import Page, Text

_INKS = {0.0: "#000", 1.0: "#fff"}


def svg(page: Page) -> str:
    """Return the text of an SVG 1.1 file whose user unit is the millimetre."""
    return "".join(f"{line}\n" for line in _lines(page))


def _lines(page: Page) -> Iterator[str]:
    width, height = (_number(side) for side in page.size)
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">'
    )
    yield f"<title>{escape(page.title)}</title>"
    yield f'<rect width="{width}" height="{height}" fill="#fff"/>'
    if page.outlines:
        yield f'<path fill="#000" d="{" ".join(map(_path, page.outlines))}"/>'
    for x, y, radius, ink in page.discs:
        yield f'<circle cx="{_number(x)}" cy="{_number(y)}" r="{_number(radius)}" fill="{_INKS[ink]}"/>'
    yield from map(_line, page.texts)
    yield "</svg>"


def _path(outline: Array) -> str:
    places = " ".join(f"{_number(x)},{_number(y)}" for x, y in outline)
    return f"M{places}Z"


def _line(text: Text) -> str:
    """Return a line of text; whatever font stands in for Helvetica is set in Helvetica's width."""
    return (
        f'<text x="{_number(text.x)}" y="{_number(text.y)}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{_number(text.size)}" textLength="{_number(text.width)}" lengthAdjust="spacingAndGlyphs">'
        f"{escape(text.words)}</text>"
    )


def _number(value: float) -> str:
    """Return a number of millimetres to 10 nm."""
    return f"{value + 0.0:.5f}".rstrip("0").rstrip(".")
