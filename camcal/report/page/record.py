"""A report page: plain records of words, tables, pictures and blocks of data, and their HTML text by templates.

Everything in the text is escaped but the style sheet and data blocks, which are checked to hold no markup.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup

from camcal.report.table import Column

GOOD, WEAK, BAD, REFUSED, UNKNOWN = "good", "weak", "bad", "refused", "unknown"
FAILURE, WARNING = "failure", "warning"

_LISTED = 20  # rows of a table that is not folded
_NUMBER = re.compile(r"[+-]?[\d.]+(e[+-]?\d+)?( / \d+)?")
_ASSETS = files("camcal.report") / "assets" / "page"
_TEMPLATES = ("page.html", "parts.html")
_MARKUP = re.compile("[<>&]")


@dataclass(frozen=True)
class ShownMessage:
    """A failure or a warning. what: what was found. remedy: what to do, "" where the message does not say it.

    rule: the criterion that applies, in words. where: file or camera, "" for the whole result.
    """

    level: str
    code: str
    what: str
    remedy: str = ""
    rule: str = ""
    where: str = ""


@dataclass(frozen=True)
class PageVerdict:
    """Whether the result may be trusted, in words; remedy: what to do.

    state: GOOD, WEAK (usable, with warnings), BAD, REFUSED, UNKNOWN.
    """

    state: str
    headline: str
    why: str
    remedy: str = ""


@dataclass(frozen=True)
class Figure:
    """A key figure: its name, its value with its standard deviation and unit, and what it means."""

    name: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Picture:
    """A plot as data URIs, of the light theme and of the dark one; size: width and height in pixels of the page."""

    name: str
    title: str
    caption: str
    alt: str
    light: str
    dark: str
    size: tuple[int, int]


@dataclass(frozen=True)
class Table:
    """A table; its rows begin with their head. numeric: which columns hold numbers. folded: opened by the reader."""

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[bool]
    folded: bool = False

    @classmethod
    def of(
        cls, caption: str, heads: Sequence[str], rows: Sequence[Sequence[object]], *, folded: bool = False
    ) -> "Table":
        """Return a table of cells; those of None are empty. A long one is folded in any case."""
        cells = [["" if cell is None else str(cell) for cell in row] for row in rows]
        numeric = [_holds_numbers(column) for column in zip(*cells, strict=True)]
        return cls(caption, heads, cells, numeric, folded or len(cells) > _LISTED)

    @classmethod
    def under(cls, caption: str, columns: Sequence[Column], rows: Sequence[Sequence[object]]) -> "Table":
        """Return a table of cells under the heads that a terminal shows."""
        return cls.of(caption, [column.head for column in columns], rows)


def _holds_numbers(cells: Sequence[str]) -> bool:
    """Return whether most cells of a column that hold anything hold a number."""
    filled = [cell for cell in cells if cell]
    return 2 * sum(_NUMBER.fullmatch(cell) is not None for cell in filled) > len(filled)


@dataclass(frozen=True)
class Thumbnail:
    """An image with its corners and residuals; paths are those of an SVG in pixels of the image.

    key: under which its photograph is found again. photo: a JPEG as a data URI, "" without one. used: whether it counts
    in the calibration. dots, arrows, crosses: corners, residuals magnified, rejected corners.
    """

    key: str
    title: str
    words: str
    size: tuple[int, int]
    used: bool
    photo: str = ""
    dots: str = ""
    arrows: str = ""
    crosses: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page under a heading. lines: sentences. commands: what to type. thumbnails: images, worst first."""

    name: str
    title: str
    lines: Sequence[str] = ()
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    thumbnails: Sequence[Thumbnail] = ()
    commands: Sequence[str] = ()


@dataclass(frozen=True)
class DataBlock:
    """Data that the page carries: the id of its element, its media type, and its text, which holds no markup."""

    name: str
    type: str
    text: str


@dataclass(frozen=True)
class Page:
    """A report. subtitle: what it is of, in a line. made: program and version. blocks: what it is run again with."""

    title: str
    subtitle: str
    verdict: PageVerdict
    messages: Sequence[ShownMessage]
    figures: Sequence[Figure]
    sections: Sequence[Section]
    made: str
    blocks: Sequence[DataBlock] = ()


def rendered(page: Page) -> str:
    """Return the text of the page; the same record gives the same text."""
    return _environment().get_template("page.html").render(page=page, style=_style(), data=_data)


@cache
def _environment() -> Environment:
    sources = {name: _asset(name) for name in _TEMPLATES}
    return Environment(
        loader=DictLoader(sources), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )


@cache
def _style() -> Markup:
    return Markup(_asset("style.css"))  # noqa: S704 - the style sheet of the package


def _data(block: DataBlock) -> Markup:
    """Return the text of a data block; raises ValueError if it could end the element that holds it."""
    if _MARKUP.search(block.text):
        raise ValueError(f"{block.name}: markup in a data block")
    return Markup(block.text)  # noqa: S704 - it has no markup


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
