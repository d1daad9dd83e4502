"""Sheets of paper, and a page as every kind of file draws it: black shapes, discs and lines of text.

Everything is in millimetres from the page's upper left corner, x right, y down.
"""

import re
from dataclasses import dataclass

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
