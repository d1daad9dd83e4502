"""Tracks of objects: every frame with its state, as a wide table (CSV), YAML or JSON.

A frame without a pose has empty cells in a table, and no such keys in YAML and JSON. Read back are the trajectories of
the objects, the frames that have a pose; trajectories for other programs are in `trajectories`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.estimate.tracking.track import Track
from camcal.formats import emit
from camcal.formats.covariance import ORDER, POSITION, QUATERNION, STEPS
from camcal.formats.documents import Document, child
from camcal.formats.poses.record import PoseRecord
from camcal.formats.schema import COVARIANCE_OF_POSE, STATISTIC, STD, integer, items, mapping, number, one_of, text
from camcal.formats.tables import Lines, Table, cell, require_frames, trajectory_of
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory

FORMAT, VERSION = "camcal-track", 1
SUFFIXES = (".csv", ".yaml", ".yml", ".json")
VELOCITY = ("vx", "vy", "vz", "wx", "wy", "wz")

_POSE = (*POSITION, *QUATERNION)
_STD = tuple(f"std_{name}" for name in ORDER)
_OBJECT, _SEGMENT = "id", "segment"
_POSE_CELLS = (*_POSE, *VELOCITY, *_STD)
_NEEDED = ("t", _OBJECT, _SEGMENT, *_POSE_CELLS)
_NOT_READ = ("frame", "state", "p_branch", "nis", "candidate", "p_wrong", "rms_px", "n")

_COLUMNS = ("t", "frame", _OBJECT, _SEGMENT, "state", *_POSE_CELLS, *_NOT_READ[2:])

_WITH_A_POSE = {
    "translation": items(number(), 3),
    "quaternion": mapping(dict.fromkeys(QUATERNION, number())),
    "velocity": items(number(), 6),
    "covariance": COVARIANCE_OF_POSE,
    "segment": integer(0),
}
_OF_A_FRAME = {
    "p_branch": number(0, 1),
    "nis": STATISTIC,
    "p_wrong": number(0, 1),
    "rms_px": number(0),
    "n_points": integer(0),
    "candidate": integer(0),
}
_FRAME = mapping({"t": number(), "frame": text, "state": text}, {**_WITH_A_POSE, **_OF_A_FRAME})
_NOISE = mapping({"qv": STD, "qw": STD}, {"fading_s": number(0)})
_AMBIGUOUS = items(mapping({"start_s": number(), "end_s": number(), "p_branch": number(0, 1)}))
_TRACK = mapping({"poses": items(_FRAME)}, {"object": text, "process_noise": _NOISE, "ambiguous": _AMBIGUOUS})
CHECK = mapping(
    {"format": one_of((FORMAT,), "format"), "version": integer(1), "frames": text, "tracks": items(_TRACK)},
    {"covariance_order": items(one_of(ORDER, "coordinate"), 6), "covariance_steps": text, "velocities": text},
)


def holds_track(lines: Lines) -> bool:
    """Return whether lines are a table of `camcal track`, by the first of them."""
    return bool(lines) and lines[0][1].split()[:2] == ["#", FORMAT]


def of_table(path: Path, lines: Lines, frames: str | None) -> dict[str, Trajectory]:
    """Return the poses of the objects of a table; covariances have standard deviations alone, correlations are lost.

    frames: what the poses are. Raises InvalidInput for a wrong cell, FileError without poses.
    """
    table = Table.from_csv(str(path), lines, _NEEDED, _NOT_READ)
    pose_cells = [table.columns[name] for name in _POSE]
    posed = np.array([any(map(str.strip, cells)) for cells in zip(*pose_cells, strict=True)], dtype=bool)
    if not posed.any():
        raise FileError("holds no poses", where=str(path))
    objects = np.array(table.columns[_OBJECT])
    return {
        name: _of_rows(path, table.rows(np.flatnonzero(posed & (objects == name))), frames)
        for name in dict.fromkeys(objects[posed].tolist())
    }


def _of_rows(path: Path, table: Table, frames: str | None) -> Trajectory:
    def columns(wanted: Sequence[str]) -> Array:
        return np.column_stack([table.numbers(name) for name in wanted])

    pose = columns(_POSE)
    poses = trajectory_of(str(path), table.lines, frames, table.numbers("t"), pose[:, :3], pose[:, 3:])
    return replace(
        poses,
        covariances=columns(_STD)[:, :, None] ** 2 * np.eye(len(ORDER)),
        velocities=columns(VELOCITY),
        segments=table.numbers(_SEGMENT),
    )


def of_document(document: Document) -> dict[str, Trajectory]:
    """Return the poses of the objects in a document that passed CHECK.

    Raises InvalidInput for a frame that has a part of a pose only, FileError without poses.
    """
    found = {
        track.get("object", ""): _of_frames(document, child("tracks", number), track["poses"])
        for number, track in enumerate(document["tracks"])
        if any("translation" in frame for frame in track["poses"])
    }
    if not found:
        raise FileError("holds no poses", where=document.where)
    return found


def _of_frames(document: Document, place: str, frames: Sequence[Mapping[str, Any]]) -> Trajectory:
    where, posed = document.where, [index for index, frame in enumerate(frames) if "translation" in frame]
    for index in posed:
        missing = [name for name in _WITH_A_POSE if name not in frames[index]]
        if missing:
            raise InvalidInput(f"{place}.poses[{index}] has a translation and no {missing[0]}", where=where)
    blocks = [frames[index] for index in posed]
    lines = [document.line(child(f"{place}.poses", index)) for index in posed]
    stamps, positions, velocities, covariances, segments = (
        np.array([block[name] for block in blocks], float)
        for name in ("t", "translation", "velocity", "covariance", "segment")
    )
    quaternions = np.array([[block["quaternion"][name] for name in QUATERNION] for block in blocks], float)
    poses = trajectory_of(where, lines, require_frames(document["frames"], where), stamps, positions, quaternions)
    return replace(
        poses,
        covariances=covariances,
        velocities=velocities,
        segments=segments,
    )


def only(tracks: Mapping[str, Trajectory], where: str) -> Trajectory:
    """Return the track of the one object of a file; raises InvalidInput for several."""
    if len(tracks) > 1:
        raise InvalidInput(
            f"holds the tracks of {len(tracks)} objects ({', '.join(tracks)}); "
            "run 'camcal track' with --object for one",
            where=where,
        )
    return next(iter(tracks.values()))


class TrackedObject(NamedTuple):
    """An object's track, and what single frames gave, one for each of its frames, None for those without it."""

    track: Track
    single: Sequence[PoseRecord | None]


def write_tracks(path: Path, images: Sequence[str], objects: Mapping[str, TrackedObject]) -> None:
    """Write tracks in the form the file's suffix says; images: the names of the frames.

    Raises InvalidInput for another suffix.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv" or files.is_stream(path):
        text = "".join(f"{line}\n" for line in _csv_lines(images, objects))
    elif suffix in SUFFIXES:
        comment = "camcal tracks of objects. Lengths: m; times: s; angles: rad."
        text = emit.text_for(path, _tracks_document(images, objects), comment)
    else:
        raise InvalidInput(f"tracks are written as {', '.join(SUFFIXES)}", where=str(path))
    files.write_text(path, text)


def _tracks_document(images: Sequence[str], objects: Mapping[str, TrackedObject]) -> dict[str, Any]:
    """Return tracks as plain data."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "frames": next(iter(objects.values())).track.frames,
        "covariance_order": list(ORDER),
        "covariance_steps": STEPS,
        "velocities": "v of the translation, w with R' = hat(w) R",
        "tracks": [
            {
                **({"object": name} if name else {}),
                "process_noise": _noise(each.track),
                "ambiguous": [
                    {
                        "start_s": emit.Exact(each.track.stamps[first]),
                        "end_s": emit.Exact(each.track.stamps[last]),
                        "p_branch": chance,
                    }
                    for first, last, chance in each.track.ambiguous
                ],
                "poses": [_block(each, index, image) for index, image in enumerate(images)],
            }
            for name, each in objects.items()
        ],
    }


def _noise(track: Track) -> dict[str, Any]:
    noise = track.noise
    return {"qv": noise.translation, "qw": noise.rotation} | ({"fading_s": noise.fading} if noise.fading else {})


def _block(item: TrackedObject, index: int, image: str) -> dict[str, Any]:
    track, single = item.track, item.single[index]
    block: dict[str, Any] = {"t": emit.Exact(track.stamps[index]), "frame": image, "state": track.states[index]}
    if track.segments[index] >= 0:
        block["segment"] = int(track.segments[index])
    if track.posed[index]:
        quaternion = so3.to_quaternion(track.rotations[index]).tolist()
        block["translation"] = track.translations[index].tolist()
        block["quaternion"] = dict(zip(QUATERNION, quaternion, strict=True))
        block["velocity"] = track.velocities[index].tolist()
        block["covariance"] = track.covariances[index].tolist()
    if np.isfinite(track.p_wrong[index]):
        block["p_branch"] = 1 - float(track.p_wrong[index])
    if np.isfinite(track.nis[index]):
        block["nis"] = float(track.nis[index])
    if single is not None:
        block |= {"p_wrong": single.p_wrong, "rms_px": single.rms_px, "n_points": single.n_points}
        if track.candidates[index] >= 0:
            block["candidate"] = int(track.candidates[index])
    return block


def _csv_lines(images: Sequence[str], objects: Mapping[str, TrackedObject]) -> Iterator[str]:
    frames = next(iter(objects.values())).track.frames
    yield f"# {FORMAT} {VERSION} frames={frames}; m, s, rad; v: of the translation, w: R' = hat(w) R, R <- Exp(dr) R"
    yield ",".join(_COLUMNS)
    for name, item in objects.items():
        for index, image in enumerate(images):
            yield ",".join(_row(name, item, index, image))


def _row(name: str, item: TrackedObject, index: int, image: str) -> list[str]:
    track, single = item.track, item.single[index]
    segment = track.segments[index]
    row = [f"{track.stamps[index]:.9f}", cell(image), cell(name), str(segment) if segment >= 0 else ""]
    row.append(track.states[index])
    if track.posed[index]:
        quaternion = so3.to_quaternion(track.rotations[index])
        std = np.sqrt(np.diag(track.covariances[index]))
        numbers = (*track.translations[index], *quaternion, *track.velocities[index], *std)
        row += [f"{number:.12g}" for number in numbers]
    else:
        row += [""] * len(_POSE_CELLS)
    row.append(f"{1 - track.p_wrong[index]:.6g}" if np.isfinite(track.p_wrong[index]) else "")
    row.append(f"{track.nis[index]:.12g}" if np.isfinite(track.nis[index]) else "")
    row.append(str(track.candidates[index]) if track.candidates[index] >= 0 else "")
    return [*row, *([f"{single.p_wrong:.6g}", f"{single.rms_px:.6g}", str(single.n_points)] if single else [""] * 3)]
