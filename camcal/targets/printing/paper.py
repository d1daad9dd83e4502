"""Sheets of paper: their names, and which of them a drawing fits on."""

import re
from dataclasses import dataclass

from camcal.errors import InvalidInput

MM_PER_INCH = 25.4
POINTS_PER_MM = 72 / MM_PER_INCH
MAX_SIDE_MM = 14_400 / 72 * MM_PER_INCH  # the largest page that every reader of PDF opens

_CUSTOM = re.compile(r"([0-9]+(?:\.[0-9]*)?)x([0-9]+(?:\.[0-9]*)?)(?:mm)?", re.IGNORECASE)


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


CUSTOM = "custom paper"
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
