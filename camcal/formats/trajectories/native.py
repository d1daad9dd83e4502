"""Trajectories with every number named: camcal's own, as YAML or JSON, and the YAML of ROS transforms.

ROS transforms are those of a tf2_msgs/TFMessage. A transform's frame_id is the parent a, its child_frame_id b: it takes
coordinates in b to coordinates in a, as a_T_b.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.formats import emit
from camcal.formats.covariance import ORDER, QUATERNION, STEPS
from camcal.formats.documents import MAX_VALUES, Document, child, load_either
from camcal.formats.emit import number_text
from camcal.formats.pose_text import static_transform_publisher
from camcal.formats.schema import COVARIANCE_OF_POSE, integer, items, mapping, number, one_of, text
from camcal.formats.trajectories import tracked
from camcal.formats.trajectories.rows import named, trajectory
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory, frames_of

FORMAT = "camcal-trajectory"
VERSION = 1
TRANSFORMS = "transforms"

_OPTIONAL = {"covariance": COVARIANCE_OF_POSE, "velocity": items(number(), 6), "segment": integer(0)}
_POSE = mapping(
    {
        "t": number(),
        "translation": items(number(), 3),
        "quaternion": mapping(dict.fromkeys(QUATERNION, number())),
    },
    _OPTIONAL,
)
_CHECK = mapping(
    {"format": one_of((FORMAT,), "format"), "version": integer(1), "frames": text, "poses": items(_POSE)},
    {"epoch": integer(), "covariance_order": items(one_of(ORDER, "coordinate"), 6), "covariance_steps": text},
)
_NS = 1_000_000_000
_XYZ, _XYZW = ("x", "y", "z"), ("x", "y", "z", "w")
_STAMPED = mapping(
    {
        "header": mapping(
            {"stamp": mapping({"sec": integer(), "nanosec": integer(0)}), "frame_id": text}, {"seq": integer()}
        ),
        "child_frame_id": text,
        "transform": mapping(
            {
                "translation": mapping(dict.fromkeys(_XYZ, number())),
                "rotation": mapping(dict.fromkeys(_XYZW, number())),
            }
        ),
    }
)
_TF_CHECK = mapping({TRANSFORMS: items(_STAMPED)})


def read_objects(path: Path) -> dict[str, Trajectory]:
    """Return the trajectories of the objects of a YAML or JSON file of camcal, or of ROS transforms as YAML.

    What is no file of tracks has one without a name.
    """
    document = load_either(path)
    if TRANSFORMS in document:
        return {"": _from_transforms(document)}
    is_track = document.get("format") == tracked.FORMAT
    if faults := list((tracked.CHECK if is_track else _CHECK)(document.data, "")):
        raise document.error(faults)
    return tracked.of_document(document) if is_track else {"": _from_document(document)}


def write_json(path: Path, poses: Trajectory) -> None:
    """Write all that is known of the poses as JSON."""
    files.write_text(path, emit.json_text(document(poses)))


def write_yaml(path: Path, poses: Trajectory) -> None:
    """Write all that is known of the poses as YAML; raises InvalidInput if there are more than YAML is read with."""
    values = 16 + 44 * (poses.covariances is not None) + 8 * (poses.velocities is not None)
    if len(poses) * values > MAX_VALUES:
        raise InvalidInput(f"{len(poses)} poses exceed YAML; write .json, .csv or .tum", where=str(path))
    a, b = poses.frames.split("_T_")
    comment = f"camcal trajectory, s, m and rad. {poses.frames} takes points in {b} to points in {a}."
    files.write_text(path, emit.document(document(poses), comment))


def document(poses: Trajectory) -> dict[str, Any]:
    """Return a trajectory as plain data."""
    quaternions = so3.to_quaternion(poses.rotations).tolist()
    epoch = int(np.floor(poses.stamps[0]))  # times of clocks have more digits than numbers in files
    blocks: list[dict[str, Any]] = [
        {"t": stamp, "translation": translation, "quaternion": dict(zip(QUATERNION, quaternion, strict=True))}
        for stamp, translation, quaternion in zip(
            (poses.stamps - epoch).tolist(), poses.translations.tolist(), quaternions, strict=True
        )
    ]
    segments = None if poses.segments is None else poses.segments.astype(int)
    for name, values in (("velocity", poses.velocities), ("covariance", poses.covariances), ("segment", segments)):
        if values is not None:
            for block, value in zip(blocks, values.tolist(), strict=True):
                block[name] = value
    return {
        "format": FORMAT,
        "version": VERSION,
        "frames": poses.frames,
        "epoch": epoch,
        "covariance_order": list(ORDER),
        "covariance_steps": STEPS,
        "poses": blocks,
    }


def _from_document(document: Document) -> Trajectory:
    if document["version"] > VERSION:
        raise InvalidInput(f"version {document['version']} is newer than this camcal; upgrade it", where=document.where)
    blocks = document["poses"]
    if not blocks:
        raise FileError("holds no poses", where=document.where)
    lines = [document.line(child("poses", index)) for index in range(len(blocks))]
    stamps = np.array([block["t"] for block in blocks], float) + document.get("epoch", 0)
    positions = np.array([block["translation"] for block in blocks], float)
    quaternions = np.array([[block["quaternion"][name] for name in QUATERNION] for block in blocks], float)
    frames = named(document["frames"], document.where)
    poses = trajectory(document.where, lines, frames, stamps, positions, quaternions)
    optional = [_all(document, name) for name in _OPTIONAL]
    return Trajectory(frames, poses.stamps, poses.rotations, poses.translations, *optional)


def _all(document: Document, name: str) -> Array | None:
    """Return what every pose has under a key, None if none has it; raises InvalidInput if only some do."""
    blocks = document["poses"]
    without = [index for index, block in enumerate(blocks) if name not in block]
    if without and len(without) < len(blocks):
        raise InvalidInput(f"poses[{without[0]}] has no {name}, others have: all or none", where=document.where)
    return None if without else np.array([block[name] for block in blocks], float)


def _from_transforms(document: Document) -> Trajectory:
    """Return the trajectory of a document of transforms of one frame in one other."""
    if faults := list(_TF_CHECK(document.data, "")):
        raise document.error(faults)
    transforms = document[TRANSFORMS]
    if not transforms:
        raise FileError("holds no transforms", where=document.where)
    lines = [document.line(child(TRANSFORMS, index)) for index in range(len(transforms))]
    names = [f"{each['header']['frame_id']}_T_{each['child_frame_id']}" for each in transforms]
    other = next((index for index, name in enumerate(names) if name != names[0]), None)
    if other is not None:
        raise InvalidInput(
            f"{names[other]} after {names[0]}: one file holds one transform over time",
            where=f"{document.where}:{lines[other]}",
        )
    numbers = np.array([list(_stamped_numbers(each)) for each in transforms])
    return trajectory(document.where, lines, names[0], numbers[:, 0], numbers[:, 1:4], numbers[:, 4:])


def write_tf(path: Path, poses: Trajectory) -> None:
    """Write the poses as transforms; the file of a single one also says how to publish it."""
    head = f"# {static_transform_publisher(poses.frames, poses.pose(0))}\n" if len(poses) == 1 else ""
    files.write_text(path, f"{head}{TRANSFORMS}:\n" + "".join(_stamped(poses)))


def _stamped_numbers(stamped: dict[str, Any]) -> Iterator[float]:
    """Yield time, translation and quaternion w x y z of a transform."""
    stamp, transform = stamped["header"]["stamp"], stamped["transform"]
    yield stamp["sec"] + stamp["nanosec"] / _NS
    yield from (transform["translation"][name] for name in _XYZ)
    yield from (transform["rotation"][name] for name in ("w", *_XYZ))


def _stamped(poses: Trajectory) -> Iterator[str]:
    a, b = frames_of(poses.frames)
    rows = zip(
        poses.stamps.tolist(), poses.translations.tolist(), so3.to_quaternion(poses.rotations).tolist(), strict=True
    )
    for stamp, translation, (w, *imaginary) in rows:
        sec, nanosec = divmod(round(stamp * _NS), _NS)
        place = ", ".join(f"{name}: {number_text(value)}" for name, value in zip(_XYZ, translation, strict=True))
        turn = ", ".join(f"{name}: {number_text(value)}" for name, value in zip(_XYZW, (*imaginary, w), strict=True))
        yield (
            f"- header: {{stamp: {{sec: {sec}, nanosec: {nanosec}}}, frame_id: {a}}}\n  child_frame_id: {b}\n"
            f"  transform:\n    translation: {{{place}}}\n    rotation: {{{turn}}}\n"
        )
