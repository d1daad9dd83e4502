"""A report page: plain records of words, tables, pictures and blocks of data, and their HTML text by templates.

Everything in the text is escaped but the style sheet and data blocks, which are checked to hold no markup.
"""

import re
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup

from camcal.dataclass import dataclass
from camcal.messages import CODES, Message, counted
from camcal.quality.criteria import CRITERIA, Criterion
from camcal.report.table import Column

GOOD, WEAK, BAD, REFUSED, UNKNOWN = "good", "weak", "bad", "refused", "unknown"
FAILURE, WARNING = "failure", "warning"

_LISTED = 20  # rows of a table that is not folded
_MOST_WARNINGS = 3  # that are not folded
_NUMBER = re.compile(r"[+-]?[\d.]+(e[+-]?\d+)?( / \d+)?")
_ASSETS = files("camcal.report") / "assets" / "page"
_TEMPLATES = ("page.html", "parts.html")
_MARKUP = re.compile("[<>&]")

_MEANINGS = {code: words for group in CODES.values() for code, words in group.items()}
_REMEDY = ": "  # what a message says is: what was found: what to do


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
    return (
        _environment()
        .get_template("page.html")
        .render(page=page, style=_style(), data=_data, most_warnings=_MOST_WARNINGS)
    )


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


def shown_messages(failures: Iterable[Message], warnings: Iterable[Message]) -> tuple[ShownMessage, ...]:
    """Return failures, then warnings, each with what to do and the rule that it is from."""
    every = [(FAILURE, each) for each in failures] + [(WARNING, each) for each in warnings]
    return tuple(_show_message(level, each) for level, each in every)


def _show_message(level: str, message: Message) -> ShownMessage:
    what, remedy = _parts(message.text)
    criterion = CRITERIA.get(message.code)
    rule = _MEANINGS.get(message.code, "") if criterion is None else _rule(criterion, message)
    return ShownMessage(level, message.code, what, remedy, rule, message.where or "")


def _parts(text: str) -> tuple[str, str]:
    """Return what was found and what to do as sentences, "" for what is not said."""
    what, _, remedy = text.rpartition(_REMEDY)
    return (sentence(what), sentence(remedy)) if what else (sentence(text), "")


def shown_reasons(texts: Iterable[str], where: str) -> tuple[ShownMessage, ...]:
    """Return why a file says that a calibration is not to be trusted."""
    return tuple(ShownMessage(FAILURE, "", *_parts(text), where=where) for text in texts)


def sentence(text: str) -> str:
    """Return words as a sentence; names of parameters and files keep their letters."""
    first = text.partition(" ")[0].rstrip(",;")
    begun = text[:1].upper() + text[1:] if first.isalpha() and len(first) > 2 else text
    return f"{begun}." if begun and begun[-1] not in ".!?" else begun


def _rule(criterion: Criterion, message: Message) -> str:
    value = message.values.get("value")
    if not criterion.limit:  # there is nothing to compare
        return criterion.means
    found = f", found {value:.3g}" if isinstance(value, float) else ""
    return f"{criterion.means} (limit {_limit(criterion)}{found})"


def _limit(criterion: Criterion) -> str:
    return f"{criterion.limit:g} {criterion.unit}".strip()


def verdict(failures: Sequence[Message], warnings: Sequence[Message], known: str) -> PageVerdict:
    """Return the verdict of a calibration with these failures and warnings; known: how well it is known, a sentence."""
    if failures:
        why = (
            f"{counted(len(failures), 'check')} failed: what is measured with this calibration may be wrong by more "
            "than its standard deviations say."
        )
        return PageVerdict(BAD, "Do not trust this calibration", why, "The figures below serve to find the cause.")
    if warnings:
        headline = f"Trustworthy, with {counted(len(warnings), 'warning')}"
        return PageVerdict(
            WEAK, headline, f"No check failed. {known}", "The warnings say what is weak, and how to improve it."
        )
    return PageVerdict(GOOD, "Trustworthy", f"All {len(CRITERIA)} checks passed. {known}")


def refusal(message: Message) -> tuple[PageVerdict, ShownMessage]:
    """Return the verdict of detections that no calibration can be made from, and why."""
    why = "No calibration can be made from these detections. Nothing was written but this report."
    return PageVerdict(REFUSED, "No calibration", why), _show_message(FAILURE, message)


def checks_table(messages: Sequence[Message], owner: str) -> Table:
    """Return the table of all criteria and whether they are met; owner: what ends its caption."""
    found = {each.code: each for each in messages}
    rows = [
        [
            criterion.code,
            _result(criterion, criterion.code in found),
            _limit(criterion),
            f"{value:.3g}"
            if criterion.code in found and isinstance(value := found[criterion.code].values.get("value"), float)
            else "",
            criterion.means,
        ]
        for criterion in CRITERIA.values()
    ]
    heads = ("check", "result", "limit", "found", "applies to")
    return Table.of(f"All checks{owner}", heads, rows, folded=True)


def _result(criterion: Criterion, applies: bool) -> str:
    if not applies:
        return "passed"
    return FAILURE if criterion.failure else WARNING
