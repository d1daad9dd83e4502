"""Tables of points: a CSV with columns x, y, z, optionally nx, ny, nz and sxx … szz, in any case, and any others."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats.tables import Table, cell, csv_rows, numbered_lines

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
COVARIANCE = ("sxx", "sxy", "sxz", "syy", "syz", "szz")

_VARIANCES = ("sxx", "syy", "szz")
_UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class PointTable:
    """Points (N, 3), their normals (N, 3) and covariances (N, 3, 3) or None, in the unit of the table and its square.

    NaN where a cell is empty. table: all columns as they stand in the file.
    """

    table: Table
    points: Array
    normals: Array | None = None
    covariances: Array | None = None


def read(path: Path) -> PointTable:
    """Return the points of a CSV whose first row names its columns; lines that begin with # are left out.

    Raises FileError, InvalidInput with file and line for a missing column, what is no number or infinite, and a
    variance below zero.
    """
    lines = [(number, line) for number, line in numbered_lines(path) if not line.startswith("#")]
    rows = csv_rows(str(path), lines)
    names = [name.strip() for name in rows[0]] if rows else []
    lower = [name.lower() for name in names]
    if any(lower.count(name) != 1 for name in POSITION):
        raise InvalidInput(f"the first row names the columns, x, y, z once among them; found {names}", where=str(path))
    if len(set(lower)) < len(lower):
        raise InvalidInput(f"column {max(lower, key=lower.count)!r} occurs twice", where=str(path))
    table = Table.of_rows(str(path), names, rows[1:], [number for number, _ in lines[1:]])
    covariances = _columns(table, COVARIANCE)
    points = _columns(table, POSITION)
    assert points is not None  # the columns are there
    return PointTable(table, points, _columns(table, NORMAL), None if covariances is None else _full(covariances))


def write(path: Path, points: PointTable) -> None:
    """Write the table with these points, normals and covariances in the place of its own, numbers with 12 digits."""
    columns = dict(points.table.columns)
    for names, values in (
        (POSITION, points.points),
        (NORMAL, points.normals),
        (COVARIANCE, None if points.covariances is None else points.covariances[:, *_UPPER]),
    ):
        for name, column in zip(names, () if values is None else values.T, strict=values is not None):
            columns[_called(columns, name)] = [_text(value) for value in column]
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    files.write_text(path, "".join(",".join(map(cell, row)) + "\n" for row in rows))


def _called(columns: Iterable[str], name: str) -> str:
    """Return how the table writes a column's name, or the name if it has none such."""
    return next((known for known in columns if known.lower() == name), name)


def _text(value: float) -> str:
    return "" if np.isnan(value) else f"{value + 0.0:.12g}"


def _columns(table: Table, names: Sequence[str]) -> Array | None:
    """Return columns of numbers (N, len(names)), None if the table has none of them; raises InvalidInput for some."""
    known = [_called(table.columns, name) for name in names]
    missing = [name for name in known if name not in table.columns]
    if len(missing) == len(names):
        return None
    if missing:
        raise InvalidInput(f"column {missing[0]!r} is missing; needed with {', '.join(names)}", where=table.path)
    columns = [table.numbers_or_empty(name) for name in known]
    for name, column in zip(known, columns, strict=True):
        if name.lower() in _VARIANCES:
            _refuse_negative(table, name, column)
    return np.column_stack(columns)


def _refuse_negative(table: Table, name: str, column: Array) -> None:
    table.refuse(column < 0, lambda row: f"{name}: {table.columns[name][row]} is not a variance")


def _full(upper: Array) -> Array:
    """Return matrices (N, 3, 3) of their upper triangles (N, 6)."""
    result = np.empty((len(upper), 3, 3))
    result[:, *_UPPER] = upper
    result[:, _UPPER[1], _UPPER[0]] = upper
    return result
