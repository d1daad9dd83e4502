"""Tracks of objects: every frame with its state, as a wide table (CSV), YAML or JSON.

A frame without a pose has empty cells in a table, and no such keys in YAML and JSON. Trajectories for other programs,
of one object and of frames with a pose only, are in `trajectories`, which reads these files back.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from camcal import files
from camcal.errors import InvalidInput
from camcal.estimate.tracking.track import Track
from camcal.formats import emit
from camcal.formats.poses.record import PoseRecord
from camcal.formats.tables import cell
from camcal.geometry import rotation as so3

FORMAT, VERSION = "camcal-track", 1
SUFFIXES = (".csv", ".yaml", ".yml", ".json")

_ORDER = ("tx", "ty", "tz", "rx", "ry", "rz")
_POSE = ("tx", "ty", "tz", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")
_POSE_CELLS = (*_POSE, *(f"std_{name}" for name in _ORDER))
_COLUMNS = (
    "t",
    "frame",
    "id",
    "segment",
    "state",
    *_POSE_CELLS,
    "p_branch",
    "nis",
    "candidate",
    "p_wrong",
    "rms_px",
    "n",
)


class TrackedObject(NamedTuple):
    """An object's track, and what single frames gave, one for each of its frames, None for those without it."""

    track: Track
    single: Sequence[PoseRecord | None]


def write(path: Path, images: Sequence[str], objects: Mapping[str, TrackedObject]) -> None:
    """Write tracks in the form the file's suffix says; images: the names of the frames.

    Raises InvalidInput for another suffix.
    """
    suffix = path.suffix.lower()
    if suffix == ".csv":
        text = "".join(f"{line}\n" for line in _csv_lines(images, objects))
    elif suffix == ".json":
        text = json.dumps(emit.rounded(document(images, objects)), indent=1, ensure_ascii=False) + "\n"
    elif suffix in SUFFIXES:
        text = emit.document(document(images, objects), "camcal tracks of objects. Lengths: m; times: s; angles: rad.")
    else:
        raise InvalidInput(f"tracks are written as {', '.join(SUFFIXES)}", where=str(path))
    files.write_text(path, text)


def document(images: Sequence[str], objects: Mapping[str, TrackedObject]) -> dict[str, Any]:
    """Return tracks as plain data."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "frames": next(iter(objects.values())).track.frames,
        "covariance_order": list(_ORDER),
        "covariance_steps": "R <- Exp(dr) R, t <- t + dt",
        "velocities": "v of the translation, w with R' = hat(w) R",
        "tracks": [
            {
                **({"object": name} if name else {}),
                "process_noise": _noise(each.track),
                "ambiguous": [
                    {
                        "start_s": float(each.track.stamps[first]),
                        "end_s": float(each.track.stamps[last]),
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
    block: dict[str, Any] = {"t": float(track.stamps[index]), "frame": image, "state": track.states[index]}
    if track.segments[index] >= 0:
        block["segment"] = int(track.segments[index])
    if track.posed[index]:
        quaternion = so3.to_quaternion(track.rotations[index]).tolist()
        block["translation"] = track.translations[index].tolist()
        block["quaternion"] = dict(zip(("qw", "qx", "qy", "qz"), quaternion, strict=True))
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
