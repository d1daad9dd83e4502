"""Tables and lines of text for a width: no number and no word is broken.

A table declares its columns. Where it is too wide the columns of the highest priority are left out, and a line says
which; in full, it is continued in blocks below.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from camcal.report.uncertain import number_text

INDENT = 2
_GAP = "  "
_NARROW = {"file": 18, "wraps": 24}  # cells of columns that are made narrower
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$|[+-]?inf$|nan$")
_NO_NUMBER = ("", "-", "fixed")  # what may stand in a column of numbers
_WORD = re.compile(r" *\S+")
_UNITS = ("px", "mm", "m", "s", "%", "deg", "mrad", "rad")


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
