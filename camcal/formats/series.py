"""Tables of numbers over time: read by the names of their columns, and written smoothed."""

import json
from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.estimate.smoothing.series import Series, SmoothedSeries
from camcal.formats import emit
from camcal.formats.schema import LARGEST_STD
from camcal.formats.tables import Table, read_measurements, require_increasing
from camcal.parsing import did_you_mean

SUFFIXES = (".csv", ".json")
FORMAT = "camcal-series"
VERSION = 1

_SIGMA, _STD = "sigma", "std_"


def read(path: Path, columns: Sequence[str] = ()) -> Series:
    """Return the numbers of a CSV over time.

    columns: of the time first, then of what was measured; none: the first, and all others but sigma and sigma_NAME,
    which hold standard deviations of all, or of one column. An empty cell is a missing measurement.
    Raises InvalidInput with file and line for a name that is no column and for anything wrong in the cells.
    """
    table = read_measurements(path)
    if not columns and any(f"{_STD}{name}" in table.columns for name in table.columns):
        raise InvalidInput(
            "contains smoothed states, not measurements; choose what to smooth with --columns", where=str(path)
        )
    time, *names = columns or [name for name in table.columns if not name.startswith(_SIGMA)]
    if len({time, *names}) < 1 + len(names):
        raise InvalidInput(f"--columns names one twice: {','.join(columns)}")
    for name in (time, *names):
        if name not in table.columns:
            raise InvalidInput(f"no column {name!r}{did_you_mean(name, list(table.columns))}", where=str(path))
    if not names:
        raise InvalidInput("a column of times and at least one of measurements are needed", where=str(path))
    stamps = table.numbers(time)
    require_increasing(str(path), table.lines, stamps)
    values = np.column_stack([table.numbers_or_empty(name) for name in names])
    _require_range(table, values, "measurement")
    return Series(tuple(names), stamps, values, _deviations(table, names))


def read_controls(path: Path, series: Series) -> Array:
    """Return the known displacements (K, d) that arrive at each stamp of a series, the first of no meaning.

    The file has the time's column first and one for every column of the series; what stands between two stamps is
    summed up. Raises InvalidInput if a displacement lies outside the series.
    """
    table = read_measurements(path)
    time = next(iter(table.columns))
    missing = [name for name in series.names if name not in table.columns]
    if missing:
        raise InvalidInput(f"no column {missing[0]!r}; the input has one for every column smoothed", where=str(path))
    stamps = table.numbers(time)
    require_increasing(str(path), table.lines, stamps)
    late = stamps > series.stamps[-1] + 1e-9
    table.refuse(np.asarray(late), lambda row: f"time {stamps[row]:.9f} s is later than the last measurement")
    arrived = np.searchsorted(series.stamps, stamps - 1e-9)
    result, moves = np.zeros(series.values.shape), np.column_stack([table.numbers(name) for name in series.names])
    _require_range(table, moves, "displacement")
    np.add.at(result, arrived, moves)
    return result


def require_suffix(path: Path) -> None:
    """Raise InvalidInput unless series are written under this name."""
    if path.suffix.lower() not in SUFFIXES:
        raise InvalidInput(f"series are written as {' or '.join(SUFFIXES)}", where=str(path))


def write(path: Path, smoothed: SmoothedSeries) -> None:
    """Write the states of a series, their covariances and the filter's NIS, as CSV or JSON by the suffix.

    The NIS is left empty, or None, where no measurement was predicted.
    """
    if not files.is_stream(path):
        require_suffix(path)
    names, table = _columns(smoothed)
    if path.suffix.lower() != ".json":
        form = ",".join(["%.9f", *["%.12g"] * (len(names) - 1)])
        rows = "\n".join([(form % tuple(row)).replace("nan", "") for row in table.tolist()])
        files.write_text(path, f"# {FORMAT} {VERSION}\n{','.join(names)}\n{rows}\n")
        return
    known = np.where(np.isnan(table), np.array(None), table)  # JSON has no NaN
    columns: dict[str, Any] = dict(zip(names, known.T.tolist(), strict=True))
    document = {"format": FORMAT, "version": VERSION, "columns": columns}
    files.write_text(path, json.dumps(emit.rounded(document)) + "\n")


def _require_range(table: Table, values: Array, what: str) -> None:
    """Raise InvalidInput with the line of the first values (N, d) whose squares are hardly numbers."""
    far = np.asarray((np.abs(values) > LARGEST_STD).any(axis=1))
    table.refuse(far, lambda _: f"a {what} of more than {LARGEST_STD:g} exceeds the numerical range: check the units")


def _deviations(table: Table, names: Sequence[str]) -> Array | None:
    """Return the standard deviations (N, d) that a table has of some columns, None if it has none."""
    held = [f"{_SIGMA}_{name}" if f"{_SIGMA}_{name}" in table.columns else _SIGMA for name in names]
    if all(name not in table.columns for name in held):
        return None
    absent = [name for name in held if name not in table.columns]
    if absent:
        raise InvalidInput(f"some columns have a sigma, {names[held.index(_SIGMA)]!r} has none", where=table.path)
    result = np.column_stack([table.numbers(name) for name in held])
    _require_range(table, result, "sigma")
    table.refuse(np.asarray(~(result > 0).all(axis=1)), lambda _: "a sigma must be more than 0")
    return result


def _columns(smoothed: SmoothedSeries) -> tuple[list[str], Array]:
    """Return the names of an output's columns, and their numbers (K, C)."""
    names, columns = ["t"], [smoothed.series.stamps]
    for name, values in _states(smoothed):
        names.append(name)
        columns.append(values)
    return names, np.column_stack(columns)


def _states(smoothed: SmoothedSeries) -> Iterator[tuple[str, Array]]:
    """Yield the columns of every axis: states, their standard deviations, and what they have in common, NIS."""
    for axis, name in enumerate(smoothed.series.names):
        called = [name, *(f"{name}_{state}" for state in smoothed.motion.states[1:])]
        for index, state in enumerate(called):
            yield state, smoothed.states[:, axis, index]
        for index, state in enumerate(called):
            yield f"{_STD}{state}", np.sqrt(smoothed.covariances[:, axis, index, index])
        for i, j in combinations_with_replacement(range(len(called)), 2):
            if i != j:
                yield f"cov_{called[i]}_{called[j]}", smoothed.covariances[:, axis, i, j]
        yield f"nis_{name}", smoothed.nis[:, axis]
