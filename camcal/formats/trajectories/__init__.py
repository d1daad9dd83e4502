"""Trajectory files: the format by suffix, by content, or as asked for.

tum: lines `time tx ty tz qx qy qz qw`. csv: named columns, with covariances and velocities. yaml, json: the same with
names. kitti: 12 numbers a line, no times. tf: ROS transforms as YAML. EuRoC's data.csv is read too.
"""

from pathlib import Path

from camcal import files
from camcal.errors import InvalidInput
from camcal.formats.trajectories import native, table, tracked
from camcal.formats.trajectories.native import write_tf
from camcal.formats.trajectories.table import read_lines, read_with_repeats, write_kitti, write_tum
from camcal.geometry.pose import Trajectory

KINDS = {
    "tum": (".tum", ".txt"),
    "csv": (".csv",),
    "yaml": (".yaml", ".yml"),
    "json": (".json",),
    "kitti": (".txt", ".kitti"),
    "tf": (".yaml", ".yml"),
}
SUFFIXES = tuple(dict.fromkeys(suffix for suffixes in KINDS.values() for suffix in suffixes))

_WRITERS = {
    "tum": write_tum,
    "csv": table.write,
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
        return table.read_objects(path, frames)
    if suffix in (".yaml", ".yml", ".json"):
        return native.read_objects(path)
    if suffix in SUFFIXES:
        return {"": read_lines(path, frames)}
    raise InvalidInput(f"trajectories are {', '.join(SUFFIXES)}, found {suffix or 'no suffix'}", where=str(path))


def is_trajectory_csv(path: Path) -> bool:
    """Return whether a CSV holds poses, rather than other numbers over time."""
    return table.holds_poses(path)


def read_reference(path: Path) -> tuple[Trajectory, int]:
    """Return the trajectory to compare with, and how many poses were left out of it because their time is repeated."""
    if files.suffix_of(path) in KINDS["tum"]:
        return read_with_repeats(path)
    return read(path), 0


def write(path: str | Path, trajectory: Trajectory, kind: str | None = None) -> None:
    """Write a trajectory in the form of its suffix, or in one of KINDS; what that form cannot hold is left out."""
    path = Path(path)
    _WRITERS[kind_of(path, kind)](path, trajectory)
