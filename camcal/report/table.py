"""Tables and lines of text for a width: no number and no word is broken; values rounded by their standard deviation.

A table declares its columns. Where it is too wide the columns of the highest priority are left out, and a line says
which; in full, it is continued in blocks below.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import floor, isfinite, log10
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from camcal.dataclass import dataclass, replace

if TYPE_CHECKING:  # tables are shown by commands that import nothing heavy
    from camcal.quality.projection_uncertainty import KnownRegion
    from camcal.targets.board import Board

_FIGURES = {"rms": "RMS", "max": "worst", "centre": "centre", "median": "median", "p95": "95th percentile"}
_WHOLE = 0.995  # share of an image that is called all of it
_LEAST, _MOST = 1e-6, 1e5  # standard deviations outside of these are written with an exponent

INDENT = 2
_GAP = "  "
_NARROW = {"file": 18, "wraps": 24}  # cells of columns that are made narrower
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$|[+-]?inf$|nan$")
_NO_NUMBER = ("", "-", "fixed")  # what may stand in a column of numbers
_WORD = re.compile(r" *\S+")
_UNITS = ("px", "mm", "m", "s", "%", "deg", "mrad", "rad")


def number_text(value: float, digits: int = 4) -> str:
    """Return a number of no known uncertainty to so many digits; below a million no digit before the point is lost."""
    if 10**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def value_and_std(value: float, std: float | None) -> tuple[str, str]:
    """Return the standard deviation to two digits and the value to the same place.

    A std that is None (not known) or 0 leaves six digits of the value, and says nothing or 0.
    """
    if std is None or not isfinite(std) or std <= 0 or not isfinite(value):
        return f"{value:.6g}", "" if std is None else f"{std:.2g}"
    place = 1 - floor(log10(std))
    if _LEAST <= std < _MOST:
        places = max(0, place)
        return f"{value:z.{places}f}", f"{std:.{places}f}"
    known = round(value, place)
    digits = floor(log10(abs(known))) + place if known else 0
    return f"{known:.{max(0, digits)}e}" if known else "0", f"{std:.1e}"


def value_with_std(value: float, std: float | None) -> str:
    """Return a value with its standard deviation, such as '458.65 ± 0.41'; without it where that is not known."""
    return " ± ".join(filter(None, value_and_std(value, std)))


def length_unit(board: "Board") -> tuple[float, str]:
    """Return the factor that takes small lengths of a board to the unit that they are said in, and that unit."""
    return (1e3, "mm") if board.unit == "m" else (1.0, "squares")


def values_and_stds(values: Iterable[Any], stds: Iterable[Any]) -> tuple[str, str]:
    """Return the numbers of a vector and their standard deviations, each to the place where it is known."""
    pairs = [value_and_std(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
    return " ".join(value for value, _ in pairs), " ".join(std for _, std in pairs)


def held_by_prior_words(names: Sequence[str]) -> str:
    """Return which coefficients their priors determine rather than the data."""
    listed = ", ".join(names)
    if len(names) == 1:
        return f"{listed} is determined by its prior, not by the data"
    return f"{listed} are determined by their priors, not by the data"


def projection_words(figures: Mapping[str, float], range_m: float | None = None) -> str:
    """Return figures of a projection uncertainty by their keys in a camera file, px, as a line."""
    distance = "at infinity" if range_m is None else f"at {range_m:g} m"
    image, inside = (
        ", ".join(
            f"{words} {_two_digits(figures[key])} px"
            for name, words in _FIGURES.items()
            if (key := f"{part}{name}_px") in figures
        )
        for part in ("", "inside_")
    )
    parts = [image] if image else []
    parts += [f"where corners were seen: {inside}"] if inside else []
    return f"Projection uncertainty (1 sigma, {distance}): {'; '.join(parts)}"


def region_words(region: "KnownRegion | None", camera: str = "") -> str:
    """Return what limits a verdict to a part of the image, "" where it holds for all of it or that is not known.

    camera: whose image it is, where there are several.
    """
    if region is None or region.share > _WHOLE:
        return ""
    image = f"the image of {camera}" if camera else "the image"
    return f" in {100 * region.share:.0f} % of {image} (projection uncertainty up to {region.limit_px:.2g} px)"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"


@dataclass(frozen=True)
class Column:
    """A column of a table by its head: a title and a unit.

    priority: 0 is always shown, of the others the highest is left out first. file: its cells are paths, shown by their
    names where these differ. wraps: its cells are sentences, which may take several lines.
    """

    title: str = ""
    unit: str = ""
    priority: int = 0
    file: bool = False
    wraps: bool = False

    @property
    def head(self) -> str:
        """The title with its unit."""
        return f"{self.title}, {self.unit}" if self.title and self.unit else self.title or self.unit


@dataclass(frozen=True)
class _Laid:
    """A column with its cells as text, numbers padded so that their points align; shown in `width` cells."""

    column: Column
    cells: tuple[str, ...]
    numeric: bool
    least: int
    natural: int
    width: int = 0

    @property
    def head_lines(self) -> list[str]:
        """The head in lines of the column's width."""
        return [self._padded(line) for line in wrapped(self.column.head, self.width, 0)]

    def cell_lines(self, row: int) -> list[str]:
        """Return a cell in lines of the column's width."""
        text = self.cells[row]
        lines = wrapped(text, self.width, 0) if self.column.wraps else [shortened(text, self.width)]
        return [self._padded(line) for line in lines]

    def _padded(self, line: str) -> str:
        padding = " " * (self.width - cells(line))
        return padding + line if self.numeric else line + padding


def table_lines(
    columns: Sequence[Column], rows: Sequence[Sequence[object]], width: int, *, in_full: bool = False
) -> list[str]:
    """Return heads and rows as aligned lines of at most `width` cells; numbers to the right, None as a dash.

    in_full: all columns, and whole paths, which have a line of their own where they are too long.
    """
    laid = [_laid(column, [row[place] for row in rows], in_full) for place, column in enumerate(columns)]
    shown = laid if in_full else _by_priority(laid, width)
    if _fits(shown, width) or shown[0].least <= width // 2:
        lines = [line for block in _blocks(shown[:1], shown[1:], width) for line in _block_lines(block, width)]
    else:
        lines = [line for block in _blocks([], shown[1:], width) for line in _under_lines(shown[0], block, width)]
    left_out = dict.fromkeys(each.column.head for each in laid if each not in shown)
    if left_out:
        said = f"not shown: {'; '.join(left_out)} (--verbose or a wider terminal shows all columns)"
        lines += wrapped(" " * INDENT + said, width)
    return lines


def wrapped(line: str, width: int, hanging: int = INDENT) -> list[str]:
    """Return a line as lines of at most `width` cells, ended at spaces; a word longer than that stays whole.

    hanging: how much further than the first the other lines are indented.
    """
    if cells(line) <= width:
        return [line]
    indent = " " * (len(line) - len(line.lstrip(" ")) + hanging)
    found = [""]
    for part in _parts(line):
        if found[-1].strip() and cells(found[-1]) + cells(part) > width:
            found.append(indent + part.lstrip(" "))
        else:
            found[-1] += part
    return found


def _parts(line: str) -> list[str]:
    """Return the words of a line with the spaces before them; a number keeps its ± and its unit."""
    found: list[str] = []
    for word in _WORD.findall(line):
        bare, last = word.strip(" ,;.:()"), found[-1] if found else ""
        if last and ("±" in (bare, last.strip()[-1]) or (bare in _UNITS and last[-1].isdigit())):
            found[-1] += word
        else:
            found.append(word)
    return found


def short_names(paths: Sequence[str]) -> list[str]:
    """Return paths by as many of their last parts as distinguish them: most often the name of the file."""
    parts = {path: PurePath(path).parts for path in paths}
    count = dict.fromkeys(paths, 1)
    while True:
        names = {path: str(PurePath(*parts[path][-count[path] :])) if parts[path] else path for path in count}
        alike: dict[str, list[str]] = {}
        for path, name in names.items():
            alike.setdefault(name, []).append(path)
        longer = [path for same in alike.values() if len(same) > 1 for path in same if count[path] < len(parts[path])]
        if not longer:
            return [names[path] for path in paths]
        for path in longer:
            count[path] += 1


def shortened(text: str, width: int) -> str:
    """Return a text of at most `width` cells: more of its end than of its beginning, and … between them."""
    if cells(text) <= width:
        return text
    head = text
    while cells(head) > (width - 1) // 3:
        head = head[:-1]
    tail = text[len(head) :]
    while cells(head) + 1 + cells(tail) > width:
        tail = tail[1:]
    return f"{head}…{tail}"


def cells(text: str) -> int:
    """Return how many cells of a terminal a text takes; Chinese letters and emoji take two."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def _laid(column: Column, values: Sequence[object], in_full: bool) -> _Laid:
    texts = [_text(value) for value in values]
    if column.file and not in_full:
        texts = short_names(texts)
    numeric = any(map(_NUMBER.match, texts)) and all(text in _NO_NUMBER or _NUMBER.match(text) for text in texts)
    texts = _align(texts) if numeric else texts
    widest = max(map(cells, texts), default=0)
    natural = max(widest, cells(column.head))
    least = max([widest, *map(cells, column.head.split(" "))])
    if column.wraps:
        words = [cells(word) for text in texts for word in text.split()]
        least = min(natural, max([_NARROW["wraps"], *words]))
    elif column.file and not in_full:
        least = min(least, _NARROW["file"])
    return _Laid(column, tuple(texts), numeric, least, natural)


def _text(value: object) -> str:
    if value is None:
        return "-"
    if hasattr(value, "__float__") and not isinstance(value, int):
        return number_text(float(value))
    return str(value)


def _align(texts: Sequence[str]) -> list[str]:
    """Return numbers with spaces behind them, so that their decimal points stand above each other."""
    behind = [len(text) - text.index(".") if "." in text else 0 for text in texts]
    return [text + " " * (max(behind) - own) for text, own in zip(texts, behind, strict=True)]


def _by_priority(laid: Sequence[_Laid], width: int) -> list[_Laid]:
    """Return the columns without those of the highest priorities, until the rest fit."""
    shown = list(laid)
    while not _fits(shown, width):
        last = max(shown, key=lambda each: (each.column.priority, shown.index(each)))
        if not last.column.priority:
            break
        shown.remove(last)
    return shown


def _fits(block: Sequence[_Laid], width: int) -> bool:
    return _least(block) <= width


def _least(block: Sequence[_Laid]) -> int:
    return INDENT + sum(each.least for each in block) + len(_GAP) * (len(block) - 1)


def _blocks(first: Sequence[_Laid], rest: Sequence[_Laid], width: int) -> Iterator[list[_Laid]]:
    """Yield the columns in blocks that fit, each beginning with the first one."""
    block = [*first]
    for each in rest:
        if len(block) > len(first) and not _fits([*block, each], width - (0 if first else INDENT)):
            yield block
            block = [*first]
        block.append(each)
    yield block


def _block_lines(block: Sequence[_Laid], width: int) -> Iterator[str]:
    sized = _size_columns(block, width)
    for row in range(-1, len(block[0].cells)):
        yield from _row_lines(sized, row, INDENT)


def _under_lines(first: _Laid, block: Sequence[_Laid], width: int) -> Iterator[str]:
    """Yield the lines of a block whose first column is too wide: it has a line of its own above each row."""
    sized = _size_columns(block, width - INDENT)
    for row, text in enumerate((first.column.head, *first.cells), -1):
        yield f"{' ' * INDENT}{text}"
        yield from _row_lines(sized, row, 2 * INDENT)


def _size_columns(block: Sequence[_Laid], width: int) -> list[_Laid]:
    """Return the columns with their widths: what is to spare goes to those that lack the most."""
    widths = [each.least for each in block]
    for _ in range(width - _least(block)):
        lacking = [each.natural - own for each, own in zip(block, widths, strict=True)]
        if max(lacking, default=0) > 0:
            widths[lacking.index(max(lacking))] += 1
    return [replace(each, width=own) for each, own in zip(block, widths, strict=True)]


def _row_lines(block: Sequence[_Laid], row: int, indent: int) -> Iterator[str]:
    """Yield the lines of a row, of the heads for row -1; heads stand at the bottom of their lines, cells at the top."""
    parts = [each.head_lines if row < 0 else each.cell_lines(row) for each in block]
    height = max(map(len, parts), default=0)
    for line in range(height):
        texts = []
        for each, part in zip(block, parts, strict=True):
            place = line - (height - len(part)) if row < 0 else line
            texts.append(part[place] if 0 <= place < len(part) else " " * each.width)
        yield f"{' ' * indent}{_GAP.join(texts)}".rstrip()
