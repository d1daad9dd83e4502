"""A page as every kind of file draws it: black shapes, discs and lines of text.

Everything is in millimetres from the page's upper left corner, x right, y down.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly

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
