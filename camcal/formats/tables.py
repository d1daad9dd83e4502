"""Text tables with named columns, read a column at a time, and rows of bare numbers; errors name file and line.

The numbers of poses, which all text formats of trajectories have, become a trajectory here.
"""

import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput, Located
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory, frames_of
from camcal.parsing import LARGEST, did_you_mean, is_number, parse_integer, parse_number, parse_numbers

MAX_LINES = 3_000_000  # of a table
LONGEST_QUOTE = 60  # characters of a cell that a message repeats
COVARIANCE = ("suu", "suv", "svv")  # of u and v

DEFAULT_FRAMES = "world_T_camera"

_ROUNDED = 1e-3  # how far a quaternion's length may be from 1: files have few digits

_MARGIN = 0.1  # a pixel farther outside than this share of the image's side is a mistake, not a measurement

_APOSTROPHE = "'"
_FORMULA = ("=", "+", "@", "\t")  # a minus too, but numbers begin with it
_COMMENT = "#"
_SEPARATORS = {";": "semicolons", "\t": "tabs", " ": "blanks"}

Lines = Sequence[tuple[int, str]]


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a text file that are not blank, with their numbers from 1.

    Raises FileError if the file cannot be read or has more than MAX_LINES.
    """
    return list(iterate_lines(files.read_text(path), str(path)))


def iterate_lines(text: str, where: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text that are not blank, with their numbers from 1; where: what messages call it.

    One at a time: a line in a list takes three times the memory of its text. Raises FileError for more than MAX_LINES.
    """
    count = text.count("\n")
    if count > MAX_LINES:
        raise FileError(f"{count} lines are more than the limit of {MAX_LINES}", where=where)
    start = 0
    for number in range(1, count + 2):
        end = text.find("\n", start)
        line = text[start : end if end >= 0 else len(text)].removesuffix("\r")
        if line.strip():
            yield number, line
        start = end + 1


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
        values = self._converted(name, parse_integer, "a whole number")
        bad = np.array([not low <= value <= high for value in values], dtype=bool)
        self.refuse(bad, lambda row: f"{name} {values[row]} is not in {low} … {high}")
        return np.array(values, dtype=np.int64)

    def numbers(self, name: str) -> Array:
        """Return a column (N,) of finite numbers."""
        values = np.array(self._converted(name, parse_number, "a number"), dtype=float)
        self.refuse(~np.isfinite(values), lambda row: f"{name}: {self.columns[name][row]} is not finite")
        return values

    def numbers_or_empty(self, name: str) -> Array:
        """Return a column (N,) of finite numbers, NaN where a cell is empty or nan."""
        known = [row for row, text in enumerate(self.columns[name]) if text.strip().lower() not in ("", "nan")]
        values = np.full(len(self), np.nan)
        column = {name: [self.columns[name][row] for row in known]}
        values[known] = Table(self.path, column, [self.lines[row] for row in known]).numbers(name)
        return values

    def _converted(self, name: str, convert: Callable[[str], float], what: str) -> list[Any]:
        cells = self.columns[name]
        try:
            return list(map(convert, cells))
        except ValueError:
            pass
        bad = np.array([not _converts(cell, convert) for cell in cells])
        self.refuse(bad, lambda row: f"{name}: {cells[row]!r} is not {what}")
        return []


def pixel_covariances(table: Table) -> Array:
    """Return the covariances (N, 2, 2) of pixels, px², in columns suu, suv, svv; raises InvalidInput if one is none."""
    suu, suv, svv = (table.numbers(name) for name in COVARIANCE)
    bad = np.asarray((suu <= 0) | (suu * svv <= suv**2))
    table.refuse(bad, lambda _row: "suu, suv, svv are not positive definite")
    return np.stack([suu, suv, suv, svv], axis=1).reshape(-1, 2, 2)


def far_outside(pixels: Array, sizes: Array) -> Array:
    """Return which pixels (N, 2) are so far outside of images of sizes (N, 2) that they are no measurements."""
    outside = (pixels < -0.5 - _MARGIN * sizes) | (pixels > sizes - 0.5 + _MARGIN * sizes)
    return np.asarray(outside.any(axis=1))


def csv_rows(path: str, lines: Lines) -> list[list[str]]:
    """Return the cells of CSV lines, a row each; raises InvalidInput if a quote is left open."""
    rows: list[list[str]] = []
    reader = csv.reader((line for _, line in lines), skipinitialspace=True, strict=True)
    fault = "unclosed quote"
    try:
        for row in reader:
            if reader.line_num > len(rows) + 1:
                break
            rows.append([_unshield(text) for text in row] if _APOSTROPHE in "".join(row) else row)
        else:
            return rows
    except csv.Error as error:
        fault = str(error)
    raise InvalidInput(f"invalid CSV row: {fault}", where=f"{path}:{lines[len(rows)][0]}")


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
        raise InvalidInput(f"column {max(names, key=names.count)!r} occurs twice", where=where)


def _converts(cell: str, convert: Callable[[str], float]) -> bool:
    try:
        convert(cell)
    except ValueError:
        return False
    return True


def require_cell(path: Path) -> None:
    """Raise InvalidInput for a file whose name no table can hold."""
    if path.as_posix().splitlines() != [path.as_posix()]:
        raise InvalidInput("has a line break in its name; rename it", where=str(path))


def cell(text: str) -> str:
    """Return a text as a CSV cell that `csv_rows` reads back; raises InvalidInput for a line break in it.

    What a spreadsheet would take for a formula stands behind an apostrophe.
    """
    if text.splitlines() not in ([], [text]):
        raise InvalidInput(f"{text!r} has a line break")
    if text.lstrip(_APOSTROPHE)[:1] in _FORMULA and not is_number(text):
        text = _APOSTROPHE + text
    if text.strip() != text or any(letter in text for letter in ',"#'):
        return '"' + text.replace('"', '""') + '"'
    return text


def _unshield(text: str) -> str:
    """Return a cell without the apostrophe that `cell` put before what resembles a formula."""
    inner = text.removeprefix(_APOSTROPHE)
    return inner if inner != text and inner.lstrip(_APOSTROPHE)[:1] in _FORMULA else text


def read_measurements(path: Path) -> Table:
    """Return the table of a CSV file whose first row names its columns freely; lines that begin with # are left out.

    Raises FileError if the file cannot be read or has no rows, InvalidInput for rows of other lengths, for names that
    are numbers or stand twice, and for columns that are not separated by commas.
    """
    lines = [(number, line) for number, line in numbered_lines(path) if not line.lstrip().startswith(_COMMENT)]
    rows = csv_rows(str(path), lines)
    if len(rows) < 2:
        raise FileError("no rows of numbers below a row of column names", where=str(path))
    names = [name.strip() for name in rows[0]]
    _check_columns(f"{path}:{lines[0][0]}", names)
    return Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])


def _check_columns(where: str, names: list[str]) -> None:
    if all(map(is_number, names)):
        raise InvalidInput("no column names: the first row must name the columns, such as x,y", where=where)
    used = next((letter for letter in _SEPARATORS if len(names) == 1 and letter in names[0]), None)
    if used is not None:
        raise InvalidInput(
            f"one column, {names[0]!r}: columns are separated by commas, not {_SEPARATORS[used]}", where=where
        )
    if not all(names):
        raise InvalidInput(f"column {names.index('') + 1} has no name", where=where)
    if len(set(names)) < len(names):
        raise InvalidInput(f"column {max(names, key=names.count)!r} occurs twice", where=where)


def number_rows(path: str, lines: Lines, counts: Sequence[int], delimiter: str | None = None) -> Array:
    """Return the numbers (N, C) of lines, C one of `counts`; delimiter: None for blanks."""
    try:
        table = np.loadtxt([line for _, line in lines], delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        table = np.empty((0, 0))
    if len(table) != len(lines) or table.shape[1] not in counts:
        expected = len(lines[0][1].split(delimiter)) if lines else 0
        counts = [expected] if expected in counts else counts
        rows = [_numbers_of(f"{path}:{number}", line.split(delimiter), counts) for number, line in lines]
        for (number, _), row in zip(lines, rows, strict=True):
            if len(row) != len(rows[0]):
                message = f"{len(row)} numbers, other lines have {len(rows[0])}"
                raise InvalidInput(message, where=f"{path}:{number}")
        table = np.array(rows)
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        raise InvalidInput("a number is not finite", where=f"{path}:{lines[int(np.argmax(bad))][0]}")
    return table


def trajectory_of(
    path: str, lines: Sequence[int | str], frames: str | None, stamps: Array, positions: Array, quaternions: Array
) -> Trajectory:
    """Return the trajectory of stamps (N,), positions (N, 3) and quaternions w x y z (N, 4), checked.

    lines: where each pose stands in the file. Raises InvalidInput for stamps that do not increase and for quaternions
    that have not length 1; those that nearly have are normalised.
    """
    require_plausible(path, lines, np.column_stack([stamps, positions, quaternions]))
    require_increasing(path, lines, stamps)
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.abs(lengths - 1) > _ROUNDED
    if bad.any():
        row = int(np.argmax(bad))
        raise InvalidInput(
            f"the quaternion has length {lengths[row]:.6g}, not 1: check its order", where=f"{path}:{lines[row]}"
        )
    return Trajectory(require_frames(frames, path), stamps, so3.from_quaternion(quaternions), positions)


def require_frames(frames: str | None, where: str) -> str:
    """Return the name of the poses; raises InvalidInput unless it has the form a_T_b. None: world_T_camera."""
    name = frames or DEFAULT_FRAMES
    with Located(where):
        frames_of(name)
    return name


def require_plausible(path: str, lines: Sequence[int | str], rows: Array) -> None:
    """Raise InvalidInput about the first row of numbers (N, C) that has one beyond all limits."""
    farthest = np.abs(rows).max(axis=1, initial=0.0)
    if (farthest > LARGEST).any():
        row = int(np.argmax(farthest > LARGEST))
        raise InvalidInput(f"{farthest[row]:g} is outside [-{LARGEST:g}, {LARGEST:g}]", where=f"{path}:{lines[row]}")


def require_increasing(path: str, lines: Sequence[int | str], stamps: Array) -> None:
    """Raise InvalidInput about the first stamp (N,) that is not later than the one before."""
    late = np.flatnonzero(~(np.diff(stamps) > 0))
    if len(late):
        row = int(late[0]) + 1
        raise InvalidInput(
            f"time {stamps[row]:.9f} s is not later than the one before, {stamps[row - 1]:.9f} s; sort the file",
            where=f"{path}:{lines[row]}",
        )


def _numbers_of(where: str, cells: Sequence[str], counts: Sequence[int]) -> list[float]:
    if len(cells) not in counts:
        wanted = " or ".join(map(str, counts))
        raise InvalidInput(f"{len(cells)} numbers; {wanted} are needed", where=where)
    for cell in cells:
        try:
            parse_number(cell)
        except ValueError as error:
            raise InvalidInput(f"{cell.strip()[:LONGEST_QUOTE]!r} is not a number", where=where) from error
    return parse_numbers(cells)
