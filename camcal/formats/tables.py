"""Text tables with named columns, read a column at a time; whatever is wrong is told with file and line."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats.schema import did_you_mean

Lines = Sequence[tuple[int, str]]


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a text file that are not blank, with their numbers from 1.

    Raises FileError if the file cannot be read.
    """
    lines = files.read_text(path).replace("\r\n", "\n").split("\n")
    return [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]


@dataclass(frozen=True)
class Table:
    """Cells as text, column by column; lines: where in the file each row stands."""

    path: str
    columns: Mapping[str, Sequence[str]]
    lines: Sequence[int | str]

    @classmethod
    def from_csv(cls, path: str, lines: Lines, required: Sequence[str], optional: Sequence[str]) -> "Table":
        """Return the table of CSV lines, the first of which names the columns in any order; '#' lines are left out.

        Raises InvalidInput for a missing, unknown or repeated column, or a row of another length.
        """
        lines = [(number, line) for number, line in lines if not line.startswith("#")]
        if not lines:
            raise InvalidInput(f"no header line; the first row names the columns {','.join(required)}", where=path)
        rows = csv_rows(path, lines)
        names = [name.strip() for name in rows[0]]
        _check_names(f"{path}:{lines[0][0]}", names, required, optional)
        return cls.of_rows(path, names, rows[1:], [number for number, _ in lines[1:]])

    @classmethod
    def of_rows(
        cls, path: str, names: Sequence[str], rows: Sequence[Sequence[str]], lines: Sequence[int | str]
    ) -> "Table":
        """Return the table of rows of cells; raises InvalidInput for a row of another length than the names."""
        bad = next((index for index, row in enumerate(rows) if len(row) != len(names)), None)
        if bad is not None:
            raise InvalidInput(f"{len(rows[bad])} cells under {len(names)} columns", where=f"{path}:{lines[bad]}")
        columns = zip(*rows, strict=True) if rows else [()] * len(names)
        return cls(path, dict(zip(names, columns, strict=True)), lines)

    def __len__(self) -> int:
        return len(self.lines)

    def rows(self, chosen: Array) -> "Table":
        """Return the table of the rows with the given indices."""
        columns = {name: [cells[row] for row in chosen] for name, cells in self.columns.items()}
        return Table(self.path, columns, [self.lines[row] for row in chosen])

    def refuse(self, bad: Array, describe: Callable[[int], str]) -> None:
        """Raise InvalidInput about the first row of the mask `bad` (N,), if it has one."""
        if bad.any():
            row = int(np.argmax(bad))
            raise InvalidInput(describe(row), where=f"{self.path}:{self.lines[row]}")

    def integers(self, name: str, low: int, high: int) -> Array:
        """Return a column (N,) of whole numbers in [low, high]."""
        values = self._converted(name, int, "a whole number")
        bad = np.array([not low <= value <= high for value in values], dtype=bool)
        self.refuse(bad, lambda row: f"{name} {values[row]} is not in {low} … {high}")
        return np.array(values, dtype=np.int64)

    def numbers(self, name: str) -> Array:
        """Return a column (N,) of finite numbers."""
        values = np.array(self._converted(name, float, "a number"), dtype=float)
        self.refuse(~np.isfinite(values), lambda row: f"{name}: {self.columns[name][row]} is not finite")
        return values

    def numbers_or_empty(self, name: str) -> Array:
        """Return a column (N,) of numbers, NaN where a cell is empty."""
        values = np.full(len(self), np.nan)
        for row, text in enumerate(self.columns[name]):
            try:
                values[row] = float(text) if text.strip() else np.nan
            except ValueError:
                raise InvalidInput(
                    f"{name}: {text!r} is not a number", where=f"{self.path}:{self.lines[row]}"
                ) from None
        return values

    def _converted(self, name: str, convert: Callable[[str], float], what: str) -> list[Any]:
        cells = self.columns[name]
        try:
            if "_" not in "".join(cells):  # 1_000 is a number to Python only
                return list(map(convert, cells))
        except ValueError:
            pass
        bad = np.array([not _converts(cell, convert) for cell in cells])
        self.refuse(bad, lambda row: f"{name}: {cells[row]!r} is not {what}")
        return []


def csv_rows(path: str, lines: Lines) -> list[list[str]]:
    """Return the cells of CSV lines, a row each; raises InvalidInput if a quote is left open."""
    try:
        rows = list(csv.reader((line for _, line in lines), skipinitialspace=True, strict=True))
    except csv.Error:
        rows = []
    if len(rows) != len(lines):  # an open quote swallows the lines that follow
        for number, line in lines:
            _refuse_bad_quotes(f"{path}:{number}", line)
    return rows


def _refuse_bad_quotes(where: str, line: str) -> None:
    try:
        list(csv.reader([line], skipinitialspace=True, strict=True))
    except csv.Error as error:
        raise InvalidInput(f"not a CSV row, a quote is wrong: {error}", where=where) from error


def _check_names(where: str, names: Sequence[str], required: Sequence[str], optional: Sequence[str]) -> None:
    missing = [name for name in required if name not in names]
    unknown = [name for name in names if name not in (*required, *optional)]
    if len(unknown) == len(names):
        raise InvalidInput(f"no header; the first row names the columns {','.join(required)}", where=where)
    if unknown:
        raise InvalidInput(f"unknown column {unknown[0]!r}{did_you_mean(unknown[0], missing or optional)}", where=where)
    if missing:
        raise InvalidInput(f"missing column {missing[0]!r}; needed: {','.join(required)}", where=where)
    if len(set(names)) < len(names):
        raise InvalidInput(f"column {max(names, key=names.count)!r} stands twice", where=where)


def _converts(cell: str, convert: Callable[[str], float]) -> bool:
    try:
        convert(cell)
    except ValueError:
        return False
    return "_" not in cell


def cell(text: str) -> str:
    """Return a text as a CSV cell that `Table.from_csv` reads back; raises InvalidInput for a line break in it."""
    if "\n" in text or "\r" in text:
        raise InvalidInput(f"{text!r} has a line break, which a table cannot hold")
    if text.strip() != text or any(letter in text for letter in ',"#'):
        return '"' + text.replace('"', '""') + '"'
    return text
