"""Trajectories as ROS transforms: the YAML of a tf2_msgs/TFMessage, and the command that publishes a single one.

A transform's frame_id is the parent a, its child_frame_id b: it takes coordinates in b to coordinates in a, as a_T_b.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.errors import FileError, InvalidInput
from camcal.formats.emit import number_text
from camcal.formats.schema import integer, items, mapping, number, text
from camcal.formats.strict_yaml import Document, child
from camcal.formats.trajectories.rows import trajectory
from camcal.geometry import rotation as so3
from camcal.geometry.named import frames_of
from camcal.geometry.pose import Pose, Trajectory

KEY = "transforms"

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
_CHECK = mapping({KEY: items(_STAMPED)})


def from_document(document: Document) -> Trajectory:
    """Return the trajectory of a document of transforms of one frame in one other."""
    if faults := list(_CHECK(document.data, "")):
        raise document.error(faults)
    transforms = document[KEY]
    if not transforms:
        raise FileError("holds no transforms", where=document.where)
    lines = [document.line(child(KEY, index)) for index in range(len(transforms))]
    names = [f"{each['header']['frame_id']}_T_{each['child_frame_id']}" for each in transforms]
    other = next((index for index, name in enumerate(names) if name != names[0]), None)
    if other is not None:
        raise InvalidInput(
            f"{names[other]} after {names[0]}: one file holds one transform over time",
            where=f"{document.where}:{lines[other]}",
        )
    numbers = np.array([list(_numbers(each)) for each in transforms])
    return trajectory(document.where, lines, names[0], numbers[:, 0], numbers[:, 1:4], numbers[:, 4:])


def write(path: Path, poses: Trajectory) -> None:
    """Write the poses as transforms; the file of a single one also says how to publish it."""
    head = f"# {static_transform_publisher(poses.frames, poses.pose(0))}\n" if len(poses) == 1 else ""
    files.write_text(path, f"{head}{KEY}:\n" + "".join(_stamped(poses)))


def static_transform_publisher(frames: str, a_T_b: Pose) -> str:
    """Return the command that publishes a pose that does not change."""
    a, b = frames_of(frames)
    w, x, y, z = so3.to_quaternion(a_T_b.rotation)
    values = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*a_T_b.translation, x, y, z, w), strict=True))
    options = " ".join(f"--{name} {value:.12g}" for name, value in values.items())
    return f"ros2 run tf2_ros static_transform_publisher {options} --frame-id {a} --child-frame-id {b}"


def _numbers(stamped: dict[str, Any]) -> Iterator[float]:
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
