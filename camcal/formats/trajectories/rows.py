"""Rows of numbers as trajectories, common to all text formats; errors name file and line."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput, Located
from camcal.formats.tables import LONGEST_QUOTE, Lines
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory, frames_of
from camcal.parsing import LARGEST, parse_number, parse_numbers

DEFAULT_FRAMES = "world_T_camera"

_ROUNDED = 1e-3  # how far a quaternion's length may be from 1: files have few digits


def numbers(path: str, lines: Lines, counts: Sequence[int], delimiter: str | None = None) -> Array:
    """Return the numbers (N, C) of lines, C one of `counts`; delimiter: None for blanks."""
    try:
        table = np.loadtxt([line for _, line in lines], delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        table = np.empty((0, 0))
    if len(table) != len(lines) or table.shape[1] not in counts:
        expected = len(lines[0][1].split(delimiter)) if lines else 0
        counts = [expected] if expected in counts else counts
        rows = [_numbers_of(f"{path}:{number}", line.split(delimiter), counts) for number, line in lines]
        _refuse_ragged(path, lines, [len(row) for row in rows])
        table = np.array(rows)
    bad = ~np.isfinite(table).all(axis=1)
    if bad.any():
        raise InvalidInput("a number is not finite", where=f"{path}:{lines[int(np.argmax(bad))][0]}")
    return table


def trajectory(
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
    return Trajectory(named(frames, path), stamps, so3.from_quaternion(quaternions), positions)


def named(frames: str | None, where: str) -> str:
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


def _refuse_ragged(path: str, lines: Lines, widths: Sequence[int]) -> None:
    other = next((index for index, width in enumerate(widths) if width != widths[0]), None)
    if other is not None:
        raise InvalidInput(f"{widths[other]} numbers, other lines have {widths[0]}", where=f"{path}:{lines[other][0]}")
