"""Sheets of paper, a page as every kind of file draws it, and its PDF and SVG files.

A page is black shapes, discs and lines of text, in millimetres from its upper left corner, x right, y down. Its files
are filled paths and Helvetica, nothing else; the same page gives the same bytes.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.sax.saxutils import escape

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput

MM_PER_INCH = 25.4
POINTS_PER_MM = 72 / MM_PER_INCH
MAX_SIDE_MM = 14_400 / 72 * MM_PER_INCH  # the largest page that every reader of PDF opens
CUSTOM = "custom paper"

# Widths of Helvetica's letters in 1/1000 of its size (Adobe's metrics of the standard fonts)
_LETTERS = {
    191: "'",
    222: "ijl",
    260: "|",
    278: " !,./:;I[\\]ft",
    333: "()-`r",
    334: "{}",
    355: '"',
    389: "*",
    469: "^",
    500: "Jcksvxyz",
    556: "#$0123456789?L_abdeghnopqu",
    584: "+<=>~",
    611: "FTZ",
    667: "&ABEKPSVXY",
    722: "CDHNRUw",
    778: "GOQ",
    833: "Mm",
    889: "%",
    944: "W",
    1015: "@",
}
_WIDTHS = {letter: width for width, letters in _LETTERS.items() for letter in letters}
_CUSTOM = re.compile(r"([0-9]+(?:\.[0-9]*)?)x([0-9]+(?:\.[0-9]*)?)(?:mm)?", re.IGNORECASE)


@dataclass(frozen=True)
class Text:
    """A line of text in Helvetica. x, y: where its baseline begins. size: of the font (mm). words: ASCII."""

    x: float
    y: float
    size: float
    words: str

    @property
    def width(self) -> float:
        """The width (mm) of the line."""
        return text_width(self.words, self.size)


@dataclass(frozen=True, eq=False)
class Page:
    """What is printed on a sheet.

    size: width and height. outlines: corners (K, 2) of shapes with level and upright edges, clockwise around black and
    the other way around holes; where shapes overlap there is black. discs: rows (D, 4) of x, y, radius and ink, 0 is
    black and 1 is white, on top of the shapes. title: of the document.
    """

    size: tuple[float, float]
    outlines: tuple[Array, ...]
    discs: Array
    texts: tuple[Text, ...]
    title: str

    def __post_init__(self) -> None:
        outlines = tuple(readonly(outline, (None, 2), "outline") for outline in self.outlines)
        object.__setattr__(self, "outlines", outlines)
        object.__setattr__(self, "discs", readonly(self.discs, (None, 4), "discs"))


def text_width(words: str, size: float) -> float:
    """Return the width of a line of ASCII text in Helvetica, in the unit of `size`."""
    return sum(_WIDTHS[letter] for letter in words) * size / 1000


def rectangle(left: float, top: float, right: float, bottom: float) -> Array:
    """Return the outline (4, 2) of a black rectangle."""
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])


@dataclass(frozen=True)
class Paper:
    """A sheet, upright as it lies before one: its name, width and height (mm)."""

    name: str
    width: float
    height: float

    @property
    def landscape(self) -> bool:
        return self.width > self.height

    def turned(self) -> "Paper":
        """Return the sheet turned by a quarter."""
        return Paper(self.name, self.height, self.width)

    def described(self) -> str:
        """Return the sheet as one names it, such as A4 landscape (297 x 210 mm)."""
        way = "" if self.name == CUSTOM else " landscape" if self.landscape else " portrait"
        return f"{self.name}{way} ({self.width:g} x {self.height:g} mm)"


SERIES = (  # from which the smallest that does is taken
    Paper("A4", 210, 297),
    Paper("A3", 297, 420),
    Paper("A2", 420, 594),
    Paper("A1", 594, 841),
    Paper("A0", 841, 1189),
)
PAPERS = (*SERIES, Paper("Letter", 215.9, 279.4), Paper("Legal", 215.9, 355.6), Paper("Tabloid", 279.4, 431.8))


def paper_named(text: str) -> Paper:
    """Return the paper of a name such as A3, or of a size such as 300x400mm; InvalidInput for others."""
    for paper in PAPERS:
        if paper.name.lower() == text.strip().lower():
            return paper
    match = _CUSTOM.fullmatch(text.strip())
    if match is None:
        names = ", ".join(paper.name for paper in PAPERS)
        raise InvalidInput(f"paper {text!r} is unknown; use {names} or a size such as 300x400mm")
    width, height = float(match[1]), float(match[2])
    if not (0 < width <= MAX_SIDE_MM and 0 < height <= MAX_SIDE_MM):
        raise InvalidInput(f"paper {text!r}: sides are above 0 and at most {MAX_SIDE_MM:.0f} mm")
    return Paper(CUSTOM, width, height)


def ways(paper: Paper, landscape: bool | None) -> tuple[Paper, ...]:
    """Return how a sheet may lie: as asked for, or both ways, upright first; one of a given size as it is given."""
    if landscape is None:
        return (paper,) if paper.name == CUSTOM else (paper, paper.turned())
    return (paper if paper.landscape == landscape else paper.turned(),)


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
