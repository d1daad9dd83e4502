"""The trajectory in a table of `camcal track`: the frames of its one object that have a pose."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats.tables import Lines, Table
from camcal.formats.trajectories.rows import ORDER, POSITION, QUATERNION, trajectory
from camcal.geometry.trajectory import Trajectory

FORMAT = "camcal-track"

VELOCITY = ("vx", "vy", "vz", "wx", "wy", "wz")
_POSE = (*POSITION, *QUATERNION)
_STD = tuple(f"std_{name}" for name in ORDER)
_OBJECT, _SEGMENT = "id", "segment"
_NEEDED = ("t", _OBJECT, _SEGMENT, *_POSE, *VELOCITY, *_STD)
_LEFT = ("frame", "state", "nis", "candidate", "p_wrong", "rms_px", "n")


def holds_track(lines: Lines) -> bool:
    """Tell whether lines are a table of `camcal track`, by the first of them."""
    return bool(lines) and lines[0][1].split()[:2] == ["#", FORMAT]


def read(path: Path, lines: Lines, frames: str | None) -> Trajectory:
    """Return the poses of a table's object; covariances have the standard deviations alone, correlations are lost.

    frames: what the poses are. Raises InvalidInput for several objects or a wrong cell, FileError without poses.
    """
    table = Table.from_csv(str(path), lines, _NEEDED, _LEFT)
    names = list(dict.fromkeys(table.columns[_OBJECT]))
    if len(names) > 1:
        raise InvalidInput(
            f"holds the tracks of {len(names)} objects ({', '.join(names)}); run 'camcal track' with --object for one",
            where=str(path),
        )
    pose_cells = [table.columns[name] for name in _POSE]
    posed = np.array([any(map(str.strip, cells)) for cells in zip(*pose_cells, strict=True)], dtype=bool)
    if not posed.any():
        raise FileError("holds no poses", where=str(path))
    table = table.rows(np.flatnonzero(posed))

    def columns(wanted: Sequence[str]) -> Array:
        return np.column_stack([table.numbers(name) for name in wanted])

    pose = columns(_POSE)
    poses = trajectory(str(path), table.lines, frames, table.numbers("t"), pose[:, :3], pose[:, 3:])
    return Trajectory(
        poses.frames,
        poses.stamps,
        poses.rotations,
        poses.translations,
        columns(_STD)[:, :, None] ** 2 * np.eye(len(ORDER)),
        columns(VELOCITY),
        table.numbers(_SEGMENT),
    )
