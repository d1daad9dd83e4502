"""Boards as pages to be printed at true scale: where the board, its white border and its footer stand on the paper."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal.errors import InvalidInput
from camcal.targets.printing.footer import RULER_MM, Footer
from camcal.targets.printing.ink import Ink
from camcal.targets.printing.page import Page
from camcal.targets.printing.paper import MAX_SIDE_MM, MM_PER_INCH, SERIES, Paper, ways
from camcal.targets.printing.pdf import pdf
from camcal.targets.printing.png import dots_per_mm, png
from camcal.targets.printing.svg import svg

KINDS = (".pdf", ".svg", ".png")
MAX_MARGIN = 1000.0  # mm
MIN_PIXELS = 4  # of the smallest detail of a board in a PNG file

_STEP = 0.5  # mm: where a board may begin, so that squares of whole millimetres lie on whole pixels at 254 dpi


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
                return _composed(ink, footer, way, sheet.margin), way
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


def _composed(ink: Ink, footer: Footer, paper: Paper, margin: float) -> Page:
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
    rooms = [_room(footer, way, sheet.margin) for way in ways(paper, sheet.landscape)]
    if all(width < footer.ruler_width for width, _ in rooms):
        return f"{paper.described()} has no room for a ruler of {RULER_MM} mm; use --no-ruler or wider paper"
    width, height = ink.bordered
    share, room = max((min(room[0] / width, room[1] / height), room) for room in rooms)
    needed, given = (f"{size[0]:g} x {size[1]:g} mm" for size in (ink.bordered, room))
    pitch = math.floor(10 * ink.pitch * share) / 10
    advice = [f"--paper {name}" for name in _enough(ink, footer, sheet)]
    advice += [f"{pitch:g} mm in place of {ink.pitch:g} mm"] if pitch > 0 else []
    return (
        f"the board takes {needed} with its white border, {paper.name} has {given} between margins of "
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
