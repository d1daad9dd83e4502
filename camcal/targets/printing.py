"""Layout of boards on pages for printing at true scale: board, white border, footer.

The ink of a board is in millimetres; one path goes around squares that share a side, so that no seam shows there. The
footer below a board is a ruler to check the print with, and what the board is.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.targets.board import Board
from camcal.targets.board_types import FORMS
from camcal.targets.page import (
    MAX_SIDE_MM,
    MM_PER_INCH,
    SERIES,
    Page,
    Paper,
    Text,
    dots_per_mm,
    pdf,
    png,
    rectangle,
    svg,
    text_width,
    ways,
)
from camcal.targets.pattern import BLACK, ink_reach, pattern_of

# Right, down, left, up: (column, row) of a step, in the order of turns to the right
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
_TURNS = (1, 0, 3)  # to the right first: squares that only touch at a corner stay apart

Edge = tuple[int, int, int]  # where it starts (column, row of the line), and which of the steps it takes


def outlines(x: Array, y: Array, black: Array) -> tuple[Array, ...]:
    """Return the outlines (K, 2) of cells that are black, clockwise (y down) around them, holes the other way.

    x (M,), y (N,): the lines between cells, ascending. black: (N - 1, M - 1) of bool.
    """
    edges = set(_edges(black))  # of which every walk uses up some
    lattice = [np.array(_walk(first, edges)) for first in sorted(edges) if first in edges]
    return tuple(np.column_stack([x[corners[:, 0]], y[corners[:, 1]]]) for corners in lattice)


def _edges(black: Array) -> Iterator[Edge]:
    """Yield the sides of black cells towards white, each with black to its right."""
    padded = np.pad(black, 1)
    inside = padded[1:-1, 1:-1]
    beside = (padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2])  # above, right, below, left
    starts = ((0, 0), (1, 0), (1, 1), (0, 1))
    for step, (neighbour, (column, row)) in enumerate(zip(beside, starts, strict=True)):
        for place in np.argwhere(inside & ~neighbour).tolist():
            yield place[1] + column, place[0] + row, step


def _walk(first: Edge, edges: set[Edge]) -> list[tuple[int, int]]:
    """Return the corners of the closed path that begins along an edge, whose edges are taken out of the set."""
    corners: list[tuple[int, int]] = []
    edge = first
    while True:
        edges.discard(edge)
        step = edge[2]
        column, row = edge[0] + _STEPS[step][0], edge[1] + _STEPS[step][1]
        onward = ((column, row, (step + turn) % 4) for turn in _TURNS)
        edge = next(way for way in onward if way == first or way in edges)
        if edge[2] != step:
            corners.append((column, row))
        if edge == first:
            return corners


MM = 1e3

_QUIET = 0.25  # width of the white around a board, of its pitch


@dataclass(frozen=True, eq=False)
class Ink:
    """The black of a board, in millimetres from its upper left corner, y down; see `Page` for outlines and discs.

    size: width and height of the board. spacing: of its squares, tags or circles. quiet: width of the white
    that belongs around it. finest: width of the smallest thing that is to be distinguished.
    """

    size: tuple[float, float]
    outlines: tuple[Array, ...]
    discs: Array
    spacing: float
    quiet: float
    finest: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "discs", readonly(self.discs, (None, 4), "discs"))

    @property
    def bordered(self) -> tuple[float, float]:
        """Width and height (mm) of the board with the white around it."""
        return self.size[0] + 2 * self.quiet, self.size[1] + 2 * self.quiet


def ink_of(board: Board) -> Ink:
    """Return what is printed of a board.

    Raises InvalidInput for a board whose lengths are not known, or whose markers the dictionary does not have.
    """
    if board.square is None:
        raise InvalidInput(f"the {board.words} has no size for printing; give it as in {FORMS[board.type]}")
    pattern, reach = pattern_of(board), ink_reach(board)
    width, height = (round((side + 2 * reach) * MM, 6) for side in board.extent)
    x, y, black = (pattern.x + reach) * MM, (pattern.y + reach) * MM, pattern.ink == BLACK
    if board.z_sign < 0:  # y points up
        y, black = height - y[::-1], black[::-1]
    discs = (pattern.discs + np.array([reach, reach, 0, 0])) * [MM, MM, MM, 1]
    spacing = board.spacing * MM
    sides = np.diff(pattern.x)[1:-1], np.diff(pattern.y)[1:-1]  # those of the white border apart
    finest = float(np.concatenate([*sides, 2 * pattern.discs[:, 2]]).min()) * MM
    return Ink((width, height), outlines(x, y, black), discs, spacing, _QUIET * spacing, finest)


KINDS = (".pdf", ".svg", ".png")
MAX_MARGIN = 1000.0  # mm
MIN_PIXELS = 4  # of the smallest detail of a board in a PNG file
RULER_MM = 100

_HEIGHT = 5.0  # of the ruler with its numbers, and of two lines of text
_GAP = 2.0  # between them where one stands above the other
_BESIDE = 8.0  # between them where they stand side by side
_LINE = 0.2  # thickness
_TICKS = {10: 3.0, 5: 2.2, 1: 1.4}  # length by what the millimetre is a multiple of
_NUMBERS = 2.0  # size of the ruler's numbers
_OVERHANG = (1.0, 6.0)  # of the ruler's first and last number
_SIZES = (2.8, 2.4)  # of the first and the second line of text
_BASELINES = (3.1, 0.3)  # above the lower edge
_STEP = 0.5  # mm: where a board may begin, so that squares of whole millimetres lie on whole pixels at 254 dpi


@dataclass(frozen=True)
class Footer:
    """A title and a line of small print, and a ruler of 100 mm or none; lengths in mm."""

    title: str
    small: str
    ruler: bool = True

    @property
    def overhang(self) -> float:
        """How far the footer begins before the ruler's zero and the text above it."""
        return _OVERHANG[0] if self.ruler else 0.0

    @property
    def ruler_width(self) -> float:
        """The width of the ruler with its numbers, 0 without one."""
        return RULER_MM + sum(_OVERHANG) if self.ruler else 0.0

    def width(self, room: float) -> float:
        """Return the width that the footer takes of `room`: ruler and text are side by side if that is enough."""
        if self.ruler and not self._stacked(room):
            return self.ruler_width + _BESIDE + self._text_width
        return max(self.ruler_width, min(self.overhang + self._text_width, room))

    def height(self, room: float) -> float:
        """Return the height of the footer in a page with `room` between the margins."""
        return _HEIGHT + _GAP + _HEIGHT if self._stacked(room) else _HEIGHT

    def _stacked(self, room: float) -> bool:
        return self.ruler and self.ruler_width + _BESIDE + self._text_width > room

    @property
    def _text_width(self) -> float:
        return max(map(text_width, (self.title, self.small), _SIZES))

    def drawn(self, left: float, bottom: float, room: float) -> tuple[tuple[Array, ...], tuple[Text, ...]]:
        """Return the shapes and the lines of text of a footer whose lower left corner is at left, bottom."""
        if not self.ruler:
            return (), self._words(left, bottom, room)
        shapes, numbers = _ruler(left + self.overhang, bottom)
        if self._stacked(room):
            words = self._words(left + self.overhang, bottom - _HEIGHT - _GAP, room - self.overhang)
        else:
            beside = self.ruler_width + _BESIDE
            words = self._words(left + beside, bottom, room - beside)
        return shapes, (*numbers, *words)

    def _words(self, left: float, bottom: float, room: float) -> tuple[Text, ...]:
        """Return the two lines, small enough for their room."""
        lines = zip((self.title, self.small), _SIZES, _BASELINES, strict=True)
        return tuple(
            Text(left, bottom - above, size * min(1.0, room / text_width(words, size)), words)
            for words, size, above in lines
        )


def _ruler(left: float, bottom: float) -> tuple[tuple[Array, ...], tuple[Text, ...]]:
    """Return a ruler whose zero is at `left`: a line, ticks centred on the millimetres, a number every ten."""
    shapes = [rectangle(left, bottom - _LINE, left + RULER_MM, bottom)]
    for place in range(RULER_MM + 1):
        length = next(length for multiple, length in _TICKS.items() if place % multiple == 0)
        middle = left + place
        shapes.append(rectangle(middle - _LINE / 2, bottom - length, middle + _LINE / 2, bottom))
    baseline = bottom - max(_TICKS.values()) - 0.5
    words = {place: str(place) for place in range(0, RULER_MM + 1, 10)}
    numbers = [
        Text(left + place - text_width(word, _NUMBERS) / 2, baseline, _NUMBERS, word) for place, word in words.items()
    ]
    unit = Text(numbers[-1].x + numbers[-1].width + 0.6, baseline, _NUMBERS, "mm")
    return tuple(shapes), (*numbers, unit)


@dataclass(frozen=True)
class Sheet:
    """The paper to print on (None: the smallest of the A series that does), how it lies, and its margin (mm).

    landscape: None for what fits. The margin is what a printer cannot reach; all that is drawn stays inside.
    """

    paper: Paper | None = None
    landscape: bool | None = None
    margin: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.margin <= MAX_MARGIN:
            raise InvalidInput(f"a margin of {self.margin:g} mm: use 0 to {MAX_MARGIN:g}")


def page_of(ink: Ink, footer: Footer, sheet: Sheet) -> tuple[Page, Paper]:
    """Return the page of a board with its footer, and the paper it is for, as it lies.

    Raises InvalidInput that says what would fit where the board does not.
    """
    wide = ink.size[0] > ink.size[1]
    for paper in SERIES if sheet.paper is None else (sheet.paper,):
        for way in sorted(ways(paper, sheet.landscape), key=lambda way: way.landscape != wide):
            if _fits(ink, footer, way, sheet.margin):
                return _compose(ink, footer, way, sheet.margin), way
    raise InvalidInput(_too_large(ink, footer, sheet))


def encoded(page: Page, path: Path, dpi: float, created: str | None = None) -> bytes:
    """Return the bytes of a page as the kind of file that the path's suffix names, one of KINDS.

    dpi: of PNG. created: the moment a PDF is to say.
    """
    if path.suffix.lower() == ".pdf":
        return pdf(page, created)
    return png(page, dpi) if path.suffix.lower() == ".png" else svg(page).encode("utf-8")


def require_fine(ink: Ink, dpi: float) -> None:
    """Raise InvalidInput for a resolution in which the details of a board would be lost."""
    pixels = ink.finest * dots_per_mm(dpi)
    if pixels < MIN_PIXELS:
        enough = math.ceil(MIN_PIXELS / ink.finest * MM_PER_INCH)
        raise InvalidInput(
            f"at {dpi:g} dpi the smallest part of the board, {ink.finest:.3g} mm, has {pixels:.1f} pixels; "
            f"it takes {MIN_PIXELS}: use {enough} dpi or more"
        )


def _room(footer: Footer, paper: Paper, margin: float) -> tuple[float, float]:
    """Return the width and height (mm) that a page has for a board and its white border."""
    width = paper.width - 2 * margin
    return width, paper.height - 2 * margin - footer.height(width)


def _fits(ink: Ink, footer: Footer, paper: Paper, margin: float) -> bool:
    room = _room(footer, paper, margin)
    beside, above = _spare(ink, room)
    return beside >= 0 and above >= 0 and room[0] >= footer.ruler_width


def _spare(ink: Ink, room: tuple[float, float]) -> tuple[float, float]:
    """Return the width and height (mm, to the nanometre) that a board with its white border leaves of its room."""
    needed = ink.bordered
    return round(room[0] - needed[0], 6), round(room[1] - needed[1], 6)


def _compose(ink: Ink, footer: Footer, paper: Paper, margin: float) -> Page:
    """Return the page: the board in its middle, or just above the footer, which begins where the board does."""
    room = _room(footer, paper, margin)
    beside, above = _spare(ink, room)
    gaps = beside / 2, min(above, (above + footer.height(room[0])) / 2)
    first = margin + ink.quiet
    place = [max(first, math.floor((first + gap) / _STEP) * _STEP) for gap in gaps]
    left = max(margin, min(place[0] - footer.overhang, paper.width - margin - footer.width(room[0])))
    shapes, texts = footer.drawn(left, paper.height - margin, room[0])
    outlines = tuple(outline + place for outline in ink.outlines)
    discs = ink.discs + np.array([*place, 0, 0])
    return Page((paper.width, paper.height), (*outlines, *shapes), discs, texts, footer.title)


def _too_large(ink: Ink, footer: Footer, sheet: Sheet) -> str:
    """Return what is wrong with the size of a board, and what would fit."""
    paper = sheet.paper or SERIES[-1]
    printable = [_room(footer, way, sheet.margin) for way in ways(paper, sheet.landscape)]
    if all(width < footer.ruler_width for width, _ in printable):
        return f"{paper.described()} is too narrow for a ruler of {RULER_MM} mm: use --no-ruler or wider paper"
    width, height = ink.bordered
    share, room = max((min(room[0] / width, room[1] / height), room) for room in printable)
    needed, given = (f"{size[0]:g} x {size[1]:g} mm" for size in (ink.bordered, room))
    spacing = math.floor(10 * ink.spacing * share) / 10
    advice = [f"--paper {name}" for name in _enough(ink, footer, sheet)]
    advice += [f"{spacing:g} mm in place of {ink.spacing:g} mm"] if spacing > 0 else []
    return (
        f"the board needs {needed} with its white border, {paper.name} has {given} within margins of "
        f"{sheet.margin:g} mm and above the footer: use {', or '.join(advice) or 'a smaller margin'}"
    )


def _enough(ink: Ink, footer: Footer, sheet: Sheet) -> list[str]:
    """Return the name or the size of a paper on which a board fits, none if it would be too large for any file."""
    for paper in SERIES:
        if any(_fits(ink, footer, way, sheet.margin) for way in ways(paper, sheet.landscape)):
            return [paper.name]
    width = max(ink.bordered[0], footer.ruler_width)
    height = ink.bordered[1] + footer.height(width)
    if sheet.landscape is not None:
        width, height = (max(width, height), height) if sheet.landscape else (width, max(width, height))
    sides = [math.ceil(side + 2 * sheet.margin) for side in (width, height)]
    return ["{}x{}mm".format(*sides)] if max(sides) <= MAX_SIDE_MM else []
