"""A page as a PDF or an SVG file: filled paths and Helvetica, nothing else; the same page gives the same bytes."""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from xml.sax.saxutils import escape

from camcal.arrays import Array
from camcal.targets.printing.page import POINTS_PER_MM, Page, Text

_EIGHTH = math.pi / 8  # half of an arc
_REACH = 4 / 3 * math.tan(_EIGHTH / 2)  # of a Bézier curve's handles; eight arcs are round to 5e-6 of the radius
_INKS = {0.0: "#000", 1.0: "#fff"}


def pdf(page: Page, created: str | None = None) -> bytes:
    """Return the bytes of a PDF 1.4 file with one page.

    Viewers are asked to print it unscaled. created: the moment in its information, as 2026-01-31T12:00:00Z.
    """
    # Rounded down, or rasterisers would add a row of pixels
    width, height = (_number(math.floor(side * POINTS_PER_MM * 1e4) / 1e4) for side in page.size)
    content = "\n".join(_content(page)).encode("ascii")
    date = "" if created is None else f" /CreationDate (D:{''.join(filter(str.isdigit, created))}Z)"
    return _file(
        [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None /DisplayDocTitle true >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width} {height}] /Contents 5 0 R "
            "/Resources << /Font << /F1 4 0 R >> >> >>".encode("ascii"),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
            b"<< /Length %d >>\nstream\n%b\nendstream" % (len(content), content),
            f"<< /Title {_text(page.title)} /Producer (camcal){date} >>".encode("ascii"),
        ]
    )


def _file(objects: Sequence[bytes]) -> bytes:
    """Return a file of numbered objects: the first is the catalogue, the last the information."""
    written = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n")  # bytes that tell transfers that it is no text
    offsets = []
    for number, body in enumerate(objects, 1):
        offsets.append(len(written))
        written += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    size, start = len(objects) + 1, len(written)
    written += b"xref\n0 %d\n0000000000 65535 f \n%b" % (size, table)
    written += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (size, size - 1, start)
    return bytes(written)


def _content(page: Page) -> Iterator[str]:
    """Yield the operators that paint a page; PDF counts points from the lower left corner, y up."""
    height = page.size[1]
    yield "0 g"  # black of the gray ink alone
    for outline in page.outlines:
        yield from _polygon(outline, height)
    if page.outlines:
        yield "f"
    for x, y, radius, ink in page.discs:
        yield f"{_number(ink)} g"
        yield from _circle(x, height - y, radius)
        yield "f"
    yield "0 g"
    yield from (_line(text, height) for text in page.texts)


def _polygon(outline: Array, height: float) -> Iterator[str]:
    for number, (x, y) in enumerate(outline):
        yield f"{_place(x, height - y)} {'l' if number else 'm'}"
    yield "h"


def _circle(x: float, y: float, radius: float) -> Iterator[str]:
    """Yield the path of a circle, eight curves whose handles lie on its tangents."""
    angles = [2 * _EIGHTH * number for number in range(9)]
    ends = [(math.cos(angle), math.sin(angle)) for angle in angles]
    yield f"{_place(x + radius, y)} m"
    for (cos, sin), (next_cos, next_sin) in pairwise(ends):
        path = (cos - _REACH * sin, sin + _REACH * cos), (next_cos + _REACH * next_sin, next_sin - _REACH * next_cos)
        places = [_place(x + radius * a, y + radius * b) for a, b in (*path, (next_cos, next_sin))]
        yield f"{' '.join(places)} c"
    yield "h"


def _line(text: Text, height: float) -> str:
    size, place = _number(text.size * POINTS_PER_MM), _place(text.x, height - text.y)
    return f"BT /F1 {size} Tf {place} Td {_text(text.words)} Tj ET"


def _place(x: float, y: float) -> str:
    return f"{_number(x * POINTS_PER_MM)} {_number(y * POINTS_PER_MM)}"


def _number(value: float) -> str:
    """Return a number as PDF takes it, without exponent; 1e-4 points are 35 nm."""
    return f"{value + 0.0:.4f}".rstrip("0").rstrip(".")


def _text(words: str) -> str:
    escaped = words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    return f"({escaped})"


def svg(page: Page) -> str:
    """Return the text of an SVG 1.1 file whose user unit is the millimetre."""
    return "".join(f"{line}\n" for line in _svg_lines(page))


def _svg_lines(page: Page) -> Iterator[str]:
    width, height = (_millimetres(side) for side in page.size)
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" version="1.1" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">'
    )
    yield f"<title>{escape(page.title)}</title>"
    yield f'<rect width="{width}" height="{height}" fill="#fff"/>'
    if page.outlines:
        yield f'<path fill="#000" d="{" ".join(map(_svg_path, page.outlines))}"/>'
    for x, y, radius, ink in page.discs:
        yield f'<circle cx="{_millimetres(x)}" cy="{_millimetres(y)}" r="{_millimetres(radius)}" fill="{_INKS[ink]}"/>'
    yield from map(_svg_text, page.texts)
    yield "</svg>"


def _svg_path(outline: Array) -> str:
    places = " ".join(f"{_millimetres(x)},{_millimetres(y)}" for x, y in outline)
    return f"M{places}Z"


def _svg_text(text: Text) -> str:
    """Return a line of text; whatever font stands in for Helvetica is set in Helvetica's width."""
    x, y, size, width = map(_millimetres, (text.x, text.y, text.size, text.width))
    return (
        f'<text x="{x}" y="{y}" font-family="Helvetica, Arial, sans-serif" '
        f'font-size="{size}" textLength="{width}" lengthAdjust="spacingAndGlyphs">'
        f"{escape(text.words)}</text>"
    )


def _millimetres(value: float) -> str:
    """Return a number of millimetres to 10 nm."""
    return f"{value + 0.0:.5f}".rstrip("0").rstrip(".")
