"""Trajectories as tables: a row a pose, with its covariance, velocity and segment where they are known."""

from collections.abc import Sequence
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats import tables
from camcal.formats.trajectories import line_formats, tracked
from camcal.formats.trajectories.rows import ORDER, POSITION, QUATERNION, numbers, trajectory
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

FORMAT = "camcal-trajectory"

_PAIRS = tuple(combinations_with_replacement(range(6), 2))
_POSE = ("t", *POSITION, *QUATERNION)
_COVARIANCE = tuple(f"cov_{ORDER[i]}_{ORDER[j]}" for i, j in _PAIRS)
_SEGMENT = "segment"


def read(path: Path, frames: str | None = None) -> Trajectory:
    """Return the trajectory of a CSV with the columns t,tx,ty,tz,qw,qx,qy,qz, of a track, or of a truth of EuRoC."""
    if line_formats.is_euroc(path):
        return line_formats.read_euroc(path, frames)
    lines = tables.numbered_lines(path)
    if tracked.holds_track(lines):
        return tracked.read(path, lines, frames or _named(lines))
    rows = [(number, line) for number, line in lines if not line.startswith("#")]
    # The header is checked by itself: the rows of a long file are read in one go.
    head = tables.Table.from_csv(str(path), rows[:1], _POSE, (*_COVARIANCE, *tracked.VELOCITY, _SEGMENT))
    names = list(head.columns)
    if len(rows) < 2:
        raise FileError("holds no poses", where=str(path))
    table = numbers(str(path), rows[1:], (len(names),), ",")

    def columns(wanted: Sequence[str]) -> Array | None:
        return table[:, [names.index(name) for name in wanted]] if _has(path, names, wanted) else None

    pose, where = table[:, [names.index(name) for name in _POSE]], [number for number, _ in rows[1:]]
    poses = trajectory(str(path), where, frames or _named(lines), pose[:, 0], pose[:, 1:4], pose[:, 4:])
    upper = columns(_COVARIANCE)
    return Trajectory(
        poses.frames,
        poses.stamps,
        rotations=poses.rotations,
        translations=poses.translations,
        covariances=None if upper is None else _matrices(upper),
        velocities=columns(tracked.VELOCITY),
        segments=table[:, names.index(_SEGMENT)] if _SEGMENT in names else None,
    )


def holds_poses(path: Path) -> bool:
    """Tell whether a CSV names the columns of poses, or is a ground truth of EuRoC."""
    first = next((line for _, line in tables.numbered_lines(path) if not line.startswith("#")), "")
    return line_formats.is_euroc(path) or set(QUATERNION) <= {name.strip() for name in first.split(",")}


def write(path: Path, poses: Trajectory) -> None:
    """Write a row for every pose, with all that is known of it."""
    names, columns = list(_POSE[1:]), [poses.translations, so3.to_quaternion(poses.rotations)]
    if poses.velocities is not None:
        names += tracked.VELOCITY
        columns.append(poses.velocities)
    if poses.covariances is not None:
        names += _COVARIANCE
        columns.append(np.stack([poses.covariances[:, i, j] for i, j in _PAIRS], axis=1))
    if poses.segments is not None:
        names.append(_SEGMENT)
        columns.append(poses.segments[:, None])
    table = np.column_stack(columns).tolist()
    rows = zip(poses.stamps.tolist(), table, strict=True)
    form = ",".join(["%.9f", *["%.12g"] * len(names)])
    lines = [form % (stamp, *row) for stamp, row in rows]
    head = f"# {FORMAT} 1 frames={poses.frames}; m, s, rad\n{','.join(['t', *names])}\n"
    files.write_text(path, head + "\n".join(lines) + "\n")


def _named(lines: tables.Lines) -> str | None:
    """Return the frames that the first line names."""
    _, _, after = lines[0][1].partition(" frames=") if lines[0][1].startswith("#") else ("", "", "")
    return after.partition(";")[0].strip() or None


def _has(path: Path, names: Sequence[str], wanted: Sequence[str]) -> bool:
    """Tell whether a table has columns that stand together; raises InvalidInput if it has only some of them."""
    missing = [name for name in wanted if name not in names]
    if missing and len(missing) < len(wanted):
        raise InvalidInput(
            f"missing column {missing[0]!r}; {wanted[0]} to {wanted[-1]} stand together", where=str(path)
        )
    return not missing


def _matrices(upper: Array) -> Array:
    """Return symmetric matrices (N, 6, 6) of their upper triangles (N, 21), row by row."""
    result = np.zeros((len(upper), 6, 6))
    for column, (i, j) in enumerate(_PAIRS):
        result[:, i, j] = result[:, j, i] = upper[:, column]
    return result
