"""The trajectory in a file of `camcal track`: the frames of its one object that have a pose."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats.schema import integer, items, mapping, matrix, number, one_of, text
from camcal.formats.strict_yaml import Document, child
from camcal.formats.tables import Lines, Table
from camcal.formats.trajectories.rows import ORDER, POSITION, QUATERNION, named, trajectory
from camcal.geometry.pose import Trajectory

FORMAT = "camcal-track"

VELOCITY = ("vx", "vy", "vz", "wx", "wy", "wz")
_POSE = (*POSITION, *QUATERNION)
_STD = tuple(f"std_{name}" for name in ORDER)
_OBJECT, _SEGMENT = "id", "segment"
_NEEDED = ("t", _OBJECT, _SEGMENT, *_POSE, *VELOCITY, *_STD)
_LEFT = ("frame", "state", "p_branch", "nis", "candidate", "p_wrong", "rms_px", "n")

_WITH_A_POSE = {
    "translation": items(number(), 3),
    "quaternion": mapping(dict.fromkeys(QUATERNION, number())),
    "velocity": items(number(), 6),
    "covariance": matrix(6, 6),
    "segment": integer(0),
}
_OF_A_FRAME = {
    "p_branch": number(0, 1),
    "nis": number(0),
    "p_wrong": number(0, 1),
    "rms_px": number(0),
    "n_points": integer(0),
    "candidate": integer(0),
}
_FRAME = mapping({"t": number(), "frame": text, "state": text}, {**_WITH_A_POSE, **_OF_A_FRAME})
_NOISE = mapping({"qv": number(0), "qw": number(0)}, {"fading_s": number(0)})
_AMBIGUOUS = items(mapping({"start_s": number(), "end_s": number(), "p_branch": number(0, 1)}))
_TRACK = mapping({"poses": items(_FRAME)}, {"object": text, "process_noise": _NOISE, "ambiguous": _AMBIGUOUS})
CHECK = mapping(
    {"format": one_of((FORMAT,), "format"), "version": integer(1), "frames": text, "tracks": items(_TRACK)},
    {"covariance_order": items(one_of(ORDER, "coordinate"), 6), "covariance_steps": text, "velocities": text},
)


def holds_track(lines: Lines) -> bool:
    """Tell whether lines are a table of `camcal track`, by the first of them."""
    return bool(lines) and lines[0][1].split()[:2] == ["#", FORMAT]


def read(path: Path, lines: Lines, frames: str | None) -> Trajectory:
    """Return the poses of a table's object; covariances have the standard deviations alone, correlations are lost.

    frames: what the poses are. Raises InvalidInput for several objects or a wrong cell, FileError without poses.
    """
    table = Table.from_csv(str(path), lines, _NEEDED, _LEFT)
    names = list(dict.fromkeys(table.columns[_OBJECT]))
    _require_one(names, str(path))
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
        rotations=poses.rotations,
        translations=poses.translations,
        covariances=columns(_STD)[:, :, None] ** 2 * np.eye(len(ORDER)),
        velocities=columns(VELOCITY),
        segments=table.numbers(_SEGMENT),
    )


def from_document(document: Document) -> Trajectory:
    """Return the poses of the one object in a document that passed CHECK.

    Raises InvalidInput for several objects or a frame that has a part of a pose only, FileError without poses.
    """
    where, tracks = document.where, document["tracks"]
    _require_one([track.get("object", "") for track in tracks], where)
    frames = [] if not tracks else tracks[0]["poses"]
    posed = [index for index, frame in enumerate(frames) if "translation" in frame]
    if not posed:
        raise FileError("holds no poses", where=where)
    for index in posed:
        missing = [name for name in _WITH_A_POSE if name not in frames[index]]
        if missing:
            raise InvalidInput(f"tracks[0].poses[{index}] has a translation and no {missing[0]}", where=where)
    blocks = [frames[index] for index in posed]
    lines = [document.line(child("tracks[0].poses", index)) for index in posed]
    stamps, positions, velocities, covariances, segments = (
        np.array([block[name] for block in blocks], float)
        for name in ("t", "translation", "velocity", "covariance", "segment")
    )
    quaternions = np.array([[block["quaternion"][name] for name in QUATERNION] for block in blocks], float)
    poses = trajectory(where, lines, named(document["frames"], where), stamps, positions, quaternions)
    return Trajectory(
        poses.frames,
        poses.stamps,
        rotations=poses.rotations,
        translations=poses.translations,
        covariances=covariances,
        velocities=velocities,
        segments=segments,
    )


def _require_one(objects: Sequence[str], where: str) -> None:
    if len(objects) > 1:
        raise InvalidInput(
            f"holds the tracks of {len(objects)} objects ({', '.join(objects)}); "
            "run 'camcal track' with --object for one",
            where=where,
        )
