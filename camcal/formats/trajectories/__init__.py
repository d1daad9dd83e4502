"""Trajectory files: the format by suffix, by content, or as asked for.

tum: lines `time tx ty tz qx qy qz qw`. csv: named columns, with covariances and velocities. yaml, json: the same with
names. kitti: 12 numbers a line, no times. tf: ROS transforms as YAML. EuRoC's data.csv is read too.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats import tables
from camcal.formats.covariance import PAIRS, POSITION, QUATERNION, from_upper, names_of_pairs
from camcal.formats.tables import number_rows, require_frames, require_plausible, trajectory_of
from camcal.formats.trajectories import native, tracked
from camcal.formats.trajectories.native import write_tf
from camcal.formats.trajectories.tracked import VELOCITY
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

FORMAT = "camcal-trajectory"

_POSE = ("t", *POSITION, *QUATERNION)
_COVARIANCE = names_of_pairs("cov")
_SEGMENT = "segment"
_FRAMES = "frames:"
_TUM, _KITTI, _EUROC = 8, 12, (8, 17)
_TUM_LINE = " ".join(["%.9f", *["%.12g"] * 7])
_KITTI_LINE = " ".join(["%.12g"] * 12) + "\n"
_NS = 1e-9
_ROUNDED = 1e-3

KINDS = {
    "tum": (".tum", ".txt"),
    "csv": (".csv",),
    "yaml": (".yaml", ".yml"),
    "json": (".json",),
    "kitti": (".txt", ".kitti"),
    "tf": (".yaml", ".yml"),
}
SUFFIXES = tuple(dict.fromkeys(suffix for suffixes in KINDS.values() for suffix in suffixes))


def read_table(path: Path, frames: str | None = None) -> dict[str, Trajectory]:
    """Return the trajectories of a CSV with the columns t,tx,ty,tz,qw,qx,qy,qz, of tracks, or of a truth of EuRoC.

    What is no file of tracks has one without a name.
    """
    if _is_euroc(path):
        return {"": _read_euroc(path, frames)}
    lines = tables.numbered_lines(path)
    if tracked.holds_track(lines):
        return tracked.of_table(path, lines, frames or _named(lines))
    return {"": _of_columns(path, lines, frames)}


def _of_columns(path: Path, lines: tables.Lines, frames: str | None) -> Trajectory:
    rows = [(number, line) for number, line in lines if not line.startswith("#")]
    # The header is checked by itself: the rows of a long file are read in one go.
    head = tables.Table.from_csv(str(path), rows[:1], _POSE, (*_COVARIANCE, *VELOCITY, _SEGMENT))
    names = list(head.columns)
    if len(rows) < 2:
        raise FileError("holds no poses", where=str(path))
    table = number_rows(str(path), rows[1:], (len(names),), ",")

    def columns(wanted: Sequence[str]) -> Array | None:
        return table[:, [names.index(name) for name in wanted]] if _has(path, names, wanted) else None

    pose, where = table[:, [names.index(name) for name in _POSE]], [number for number, _ in rows[1:]]
    poses = trajectory_of(str(path), where, frames or _named(lines), pose[:, 0], pose[:, 1:4], pose[:, 4:])
    upper = columns(_COVARIANCE)
    return replace(
        poses,
        covariances=None if upper is None else from_upper(upper),
        velocities=columns(VELOCITY),
        segments=table[:, names.index(_SEGMENT)] if _SEGMENT in names else None,
    )


def holds_poses(path: Path) -> bool:
    """Return whether a CSV names the columns of poses, or is a ground truth of EuRoC."""
    first = next((line for _, line in tables.numbered_lines(path) if not line.startswith("#")), "")
    return _is_euroc(path) or set(QUATERNION) <= {name.strip() for name in first.split(",")}


def write_table(path: Path, poses: Trajectory) -> None:
    """Write a row for every pose, with all that is known of it."""
    names, columns = list(_POSE[1:]), [poses.translations, so3.to_quaternion(poses.rotations)]
    if poses.velocities is not None:
        names += VELOCITY
        columns.append(poses.velocities)
    if poses.covariances is not None:
        names += _COVARIANCE
        columns.append(np.stack([poses.covariances[:, i, j] for i, j in PAIRS], axis=1))
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
    """Return whether a table has columns that stand together; raises InvalidInput if it has only some of them."""
    missing = [name for name in wanted if name not in names]
    if missing and len(missing) < len(wanted):
        raise InvalidInput(
            f"missing column {missing[0]!r}; {wanted[0]} to {wanted[-1]} are needed together", where=str(path)
        )
    return not missing


def read_lines(path: Path, frames: str | None = None) -> Trajectory:
    """Return the trajectory of lines of 8 numbers (TUM) or of 12 (KITTI); a line '# frames: a_T_b' names it."""
    where, table, name = _rows(path)
    if table.shape[1] == _KITTI:
        return _of_matrices(str(path), where, table, frames or name)
    return _of_tum(str(path), where, table, frames or name)


def read_with_repeats(path: Path) -> tuple[Trajectory, int]:
    """Return the trajectory of lines of 8 numbers (TUM) without those whose time is repeated, and how many these are.

    Motion capture writes them; the first of each is kept.
    """
    where, table, name = _rows(path)
    new = np.append(True, np.diff(table[:, 0]) != 0)
    kept = [where[index] for index in np.flatnonzero(new)]
    return _of_tum(str(path), kept, table[new], name), int(np.sum(~new))


def _rows(path: Path) -> tuple[list[int], Array, str | None]:
    """Return the lines' numbers, what stands in them, and the frames if a line names them."""
    lines = tables.numbered_lines(path)
    remarks = [line.lstrip("# ") for _, line in lines if line.startswith("#")]
    frames = next((line.removeprefix(_FRAMES).strip() for line in remarks if line.startswith(_FRAMES)), None)
    rows = [(number, line) for number, line in lines if not line.startswith("#")]
    if not rows:
        raise FileError("holds no poses", where=str(path))
    separator = "," if "," in rows[0][1] else None
    table = number_rows(str(path), rows, (_TUM, _KITTI), separator)
    return [number for number, _ in rows], table, frames


def _of_tum(path: str, lines: list[int], table: Array, frames: str | None) -> Trajectory:
    return trajectory_of(path, lines, frames, table[:, 0], table[:, 1:4], table[:, [7, 4, 5, 6]])


def _is_euroc(path: Path) -> bool:
    """Return whether a CSV is a ground truth of EuRoC or of what writes its form."""
    return files.read_text(path).startswith("#timestamp")


def _read_euroc(path: Path, frames: str | None = None) -> Trajectory:
    """Return the trajectory of lines `nanoseconds, x, y, z, qw, qx, qy, qz` and whatever follows."""
    rows = [(number, line) for number, line in tables.numbered_lines(path) if not line.startswith("#")]
    if not rows:
        raise FileError("holds no poses", where=str(path))
    table = number_rows(str(path), rows, _EUROC, ",")
    where = [number for number, _ in rows]
    return trajectory_of(str(path), where, frames, table[:, 0] * _NS, table[:, 1:4], table[:, 4:8])


def write_tum(path: Path, poses: Trajectory) -> None:
    """Write lines `time tx ty tz qx qy qz qw` below one that names the frames."""
    quaternions = so3.to_quaternion(poses.rotations)
    table = np.column_stack([poses.translations, quaternions[:, [1, 2, 3, 0]]])
    a, b = poses.frames.split("_T_")
    head = f"# {_FRAMES} {poses.frames}\n# time tx ty tz qx qy qz qw: pose of {b} in {a}, s and m\n"
    rows = zip(poses.stamps.tolist(), table.tolist(), strict=True)
    lines = [_TUM_LINE % (stamp, *row) for stamp, row in rows]
    files.write_text(path, head + "\n".join(lines) + "\n")


def write_kitti(path: Path, poses: Trajectory) -> None:
    """Write the upper 3 × 4 numbers of every pose in a line; times are left out, which is how the form is."""
    table = np.concatenate([poses.rotations, poses.translations[:, :, None]], axis=2).reshape(-1, 12)
    files.write_text(path, "".join([_KITTI_LINE % tuple(row) for row in table.tolist()]))


def _of_matrices(path: str, lines: list[int], table: Array, frames: str | None) -> Trajectory:
    require_plausible(path, lines, table)
    matrices = table.reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    error = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    bad = (error > _ROUNDED) | (np.linalg.det(rotations) < 0)
    if bad.any():
        raise InvalidInput("the left 3 × 3 numbers are not a rotation", where=f"{path}:{lines[int(np.argmax(bad))]}")
    stamps = np.arange(len(matrices), dtype=float)
    return Trajectory(require_frames(frames, path), stamps, so3.nearest(rotations), matrices[:, :, 3])


_WRITERS = {
    "tum": write_tum,
    "csv": write_table,
    "yaml": native.write_yaml,
    "json": native.write_json,
    "kitti": write_kitti,
    "tf": write_tf,
}


def kind_of(path: Path, kind: str | None = None) -> str:
    """Return the form a trajectory is written in under this name, `kind` if it is given; CSV to standard output.

    Raises InvalidInput if there is no such form, or it does not go with the suffix.
    """
    suffix = path.suffix.lower()
    if files.is_stream(path) and (kind is None or kind in KINDS):
        return kind or "csv"
    possible = [name for name, suffixes in KINDS.items() if suffix in suffixes]
    if kind is None and possible:
        return possible[0]
    if kind is None:
        raise InvalidInput(f"trajectories are {', '.join(SUFFIXES)}, found {suffix or 'no suffix'}", where=str(path))
    if kind not in KINDS:
        raise InvalidInput(f"format {kind!r}: use one of {', '.join(KINDS)}")
    if kind not in possible:
        raise InvalidInput(f"format {kind} is written as {' or '.join(KINDS[kind])}", where=str(path))
    return kind


def read(path: str | Path, frames: str | None = None) -> Trajectory:
    """Return the trajectory in a file; stamps of KITTI files are the numbers of their lines, from 0.

    frames: what the poses are, such as world_T_camera, where the file does not say.
    Raises FileError if it cannot be read, InvalidInput with file and line for anything wrong in it.
    """
    return tracked.only(read_objects(path, frames), str(path))


def read_objects(path: str | Path, frames: str | None = None) -> dict[str, Trajectory]:
    """Return the trajectories of the objects of a file; what is no file of `camcal track` has one without a name.

    frames, errors: as of `read`.
    """
    path = Path(path)
    suffix = files.suffix_of(path)
    if suffix == ".csv":
        return read_table(path, frames)
    if suffix in (".yaml", ".yml", ".json"):
        return native.read_objects(path)
    if suffix in SUFFIXES:
        return {"": read_lines(path, frames)}
    raise InvalidInput(f"trajectories are {', '.join(SUFFIXES)}, found {suffix or 'no suffix'}", where=str(path))


def is_trajectory_csv(path: Path) -> bool:
    """Return whether a CSV holds poses, rather than other numbers over time."""
    return holds_poses(path)


def read_reference(path: Path) -> tuple[Trajectory, int]:
    """Return the trajectory to compare with, and how many poses were left out of it because their time is repeated."""
    if files.suffix_of(path) in KINDS["tum"]:
        return read_with_repeats(path)
    return read(path), 0


def write(path: str | Path, trajectory: Trajectory, kind: str | None = None) -> None:
    """Write a trajectory in the form of its suffix, or in one of KINDS; what that form cannot hold is left out."""
    path = Path(path)
    _WRITERS[kind_of(path, kind)](path, trajectory)
