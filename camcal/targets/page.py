"""Sheets of paper, a page as every kind of file draws it, and its PDF, SVG and PNG files.

A page is black shapes, discs and lines of text, in millimetres from its upper left corner, x right, y down. PDF and SVG
files are filled paths and Helvetica, nothing else; the same page gives the same bytes. In a PNG file every pixel is as
gray as the share of it that ink covers, and the file says at which size it is printed.
"""

import math
import re
import struct
import zlib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from xml.sax.saxutils import escape

import cv2
import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
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
        for number, (x, y) in enumerate(outline):
            yield f"{_place(x, height - y)} {'l' if number else 'm'}"
        yield "h"
    if page.outlines:
        yield "f"
    for x, y, radius, ink in page.discs:
        yield f"{_number(ink)} g"
        yield from _circle(x, height - y, radius)
        yield "f"
    yield "0 g"
    for text in page.texts:
        size, place = _number(text.size * POINTS_PER_MM), _place(text.x, height - text.y)
        yield f"BT /F1 {size} Tf {place} Td {_text(text.words)} Tj ET"


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
        corners = (" ".join(f"{_millimetres(x)},{_millimetres(y)}" for x, y in outline) for outline in page.outlines)
        yield f'<path fill="#000" d="{" ".join(f"M{places}Z" for places in corners)}"/>'
    for x, y, radius, ink in page.discs:
        yield f'<circle cx="{_millimetres(x)}" cy="{_millimetres(y)}" r="{_millimetres(radius)}" fill="{_INKS[ink]}"/>'
    yield from map(_svg_text, page.texts)
    yield "</svg>"


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


MAX_PIXELS = 400_000_000

_BAND = 256  # rows of pixels drawn at a time
_CHORDS = 16  # of a disc in every row of pixels: its area is then good to 1e-3 of a pixel
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_STROKE = 0.05  # of the font's size


def dots_per_mm(dpi: float) -> float:
    """Return the resolution that a PNG file can state, whole pixels a metre, nearest to `dpi`."""
    return round(dpi / MM_PER_INCH * 1000) / 1000


def size_in_pixels(page: Page, dpi: float) -> tuple[int, int]:
    """Return the width and height of a page; raises InvalidInput for none, or for more than MAX_PIXELS."""
    width, height = (round(side * dots_per_mm(dpi)) for side in page.size)
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InvalidInput(
            f"{dpi:g} dpi makes {width} x {height} pixels; at most {MAX_PIXELS // 10**6} million are drawn"
        )
    return width, height


def png(page: Page, dpi: float) -> bytes:
    """Return the bytes of a PNG file of 8 bits gray that says how many pixels a metre it has.

    Edges are where they are to 1/255 of a pixel: a pixel is as gray as ink covers it, without gamma.
    """
    size, scale = size_in_pixels(page, dpi), dots_per_mm(dpi)
    header = struct.pack(">II", *size) + bytes([8, 0, 0, 0, 0])  # 8 bits gray, not interlaced
    metre = struct.pack(">IIB", round(scale * 1000), round(scale * 1000), 1)
    title = b"Title\0" + page.title.encode("ascii")
    chunks = (
        (b"IHDR", header),
        (b"pHYs", metre),
        (b"tEXt", title),
        (b"IDAT", _pack(page, size, scale)),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _pack(page: Page, size: tuple[int, int], scale: float) -> bytes:
    """Return the compressed rows, each as its difference from the one above (PNG's filter 2)."""
    packer = zlib.compressobj()
    above = np.zeros(size[0], np.uint8)
    parts = []
    for rows in _bands(page, size, scale):
        change = rows - np.vstack([above, rows[:-1]])
        parts.append(packer.compress(np.pad(change, ((0, 0), (1, 0)), constant_values=2).tobytes()))
        above = rows[-1]
    return b"".join([*parts, packer.flush()])


def _bands(page: Page, size: tuple[int, int], scale: float) -> Iterator[Array]:
    """Yield the rows (n, width) uint8 of a page from above, a few at a time."""
    sides = _sides(page, scale)
    for top in range(0, size[1], _BAND):
        shape = min(_BAND, size[1] - top), size[0]
        gray = np.rint(255 * (1 - np.clip(_cover(sides, top, shape), 0, 1))).astype(np.uint8)
        for text in page.texts:
            _write(gray, text, top, scale)
        yield gray


def _cover(sides: tuple[Array, ...], top: int, shape: tuple[int, int]) -> Array:
    """Return the share of ink (rows, columns) of the pixels from row `top` on; sides: see `_sides`."""
    (x, upper, lower, sign), (rows, columns) = sides, shape
    first = np.clip(np.floor(upper).astype(int) - top, 0, rows)
    last = np.clip(np.ceil(lower).astype(int) - top, 0, rows)
    side = np.repeat(np.arange(len(first)), last - first)
    row = np.arange(len(side)) - np.repeat(np.cumsum(last - first) - last, last - first)
    height = np.minimum(lower[side], row + top + 1) - np.maximum(upper[side], row + top)
    begins = np.floor(x[side]).astype(int)
    share = x[side] - begins
    weight = sign[side] * height
    # What a side adds to its own pixel, and from the next one on to all of the row
    place = row * (columns + 2) + begins
    steps = np.bincount(place, weight * (1 - share), rows * (columns + 2))
    steps += np.bincount(place + 1, weight * share, rows * (columns + 2))
    return np.cumsum(steps.reshape(rows, columns + 2), axis=1)[:, :columns]


def _sides(page: Page, scale: float) -> tuple[Array, ...]:
    """Return the upright sides of a page's shapes, and the ends of its discs' chords, in pixels.

    Their places x, their upper and lower ends, and a sign: 1 where black begins, -1 where it ends.
    """
    ends = [np.stack([outline, np.roll(outline, -1, axis=0)], axis=1) for outline in page.outlines]
    walked = np.concatenate([np.zeros((0, 2, 2)), *ends]) * scale
    walked = walked[walked[:, 0, 1] != walked[:, 1, 1]]
    x, start, end = walked[:, 0, 0], walked[:, 0, 1], walked[:, 1, 1]
    sides = [(x, np.minimum(start, end), np.maximum(start, end), np.sign(start - end))]
    sides += [_chords(disc, scale) for disc in page.discs]
    return tuple(np.concatenate(parts) for parts in zip(*sides, strict=True))


def _chords(disc: Array, scale: float) -> tuple[Array, Array, Array, Array]:
    x, y, radius = disc[:3] * scale
    edges = np.arange(np.floor((y - radius) * _CHORDS), np.ceil((y + radius) * _CHORDS) + 1) / _CHORDS
    middle = (edges[:-1] + edges[1:]) / 2
    half = np.sqrt(np.maximum(radius**2 - (middle - y) ** 2, 0))
    sign = np.where(disc[3] == 0, 1.0, -1.0)  # white takes the black below it away
    return (
        np.concatenate([x - half, x + half]),
        np.tile(edges[:-1], 2),
        np.tile(edges[1:], 2),
        np.repeat([sign, -sign], len(half)),
    )


def _write(gray: Array, text: Text, top: int, scale: float) -> None:
    """Write a line of text into rows from `top` on, as wide as it is in Helvetica."""
    x, y, size = round(text.x * scale), round(text.y * scale) - top, text.size * scale
    if not -size < y < len(gray) + size:
        return
    thickness = max(1, round(_STROKE * size))
    (width, _), _ = cv2.getTextSize(text.words, _FONT, 1.0, thickness)
    cv2.putText(gray, text.words, (x, y), _FONT, text.width * scale / width, 0, thickness, cv2.LINE_AA)
