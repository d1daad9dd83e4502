"""The transforms of a camera file: right_T_left takes points in left to points in right, in metres.

    right_T_left:
      R:
        - [1.0, 0.0, 0.0]
        - [0.0, 1.0, 0.0]
        - [0.0, 0.0, 1.0]
      t: [-0.11, 0.0, 0.0]
      covariance: 6 rows of 6, order tx ty tz rx ry rz (optional)

A name is that of a camera or a free frame. Between any two frames there is at most one path.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.formats.camera_file import Transform
from camcal.formats.covariance import why_no_covariance
from camcal.formats.documents import Fault, child
from camcal.formats.schema import items, mapping, matrix, number
from camcal.geometry.pose import JOINT, Pose
from camcal.geometry.rotation import examine
from camcal.parsing import nearest

FRAMES = ("imu", "body", "world", "board", "rig", "base", "gripper")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*\Z")
ORTHONORMAL = 1e-6

_TRANSFORM = mapping({"R": matrix(3, 3), "t": items(number(), 3)}, {"covariance": matrix(6, 6)})


def check_name(name: str, path: str) -> Iterator[Fault]:
    """Check the name of a camera or a frame."""
    if not NAME.match(name) or JOINT in name:
        yield Fault(path, f"{name!r} is no name: letters and digits joined by single '_', a letter first, no '_T_'")


def check(data: Any, path: str, cameras: Sequence[str]) -> Iterator[Fault]:
    """Check all transforms; cameras: the names that the file gives its cameras."""
    yield from mapping({}, others=_check_transform)(data, path)
    tree: dict[str, str] = {}  # frame -> the frame that stands for all that are connected with it
    for key in data if isinstance(data, dict) else ():
        faults = list(_check_frames(key, child(path, key), cameras)) or list(_connect(key, child(path, key), tree))
        yield from faults


def _check_transform(data: Any, path: str) -> Iterator[Fault]:
    faults = list(_TRANSFORM(data, path))
    yield from faults
    if faults:
        return
    yield from _check_rotation(np.array(data["R"], dtype=float), child(path, "R"))
    if "covariance" in data:
        reason = why_no_covariance(np.array(data["covariance"], dtype=float))
        yield from [Fault(child(path, "covariance"), reason)] if reason else ()


def _check_rotation(matrix: Array, path: str) -> Iterator[Fault]:
    found = examine(matrix)
    if fault := found.fault(ORTHONORMAL):
        advice = "; write R with 9 digits or more" if found.can_be_fixed else ""
        yield Fault(path, f"{fault}{advice}")


def _check_frames(key: str, path: str, cameras: Sequence[str]) -> Iterator[Fault]:
    frames = key.split(JOINT)
    if len(frames) != 2:
        yield Fault(path, f"{key!r} is no transform; write a_T_b, which takes points in b to points in a")
        return
    for name in frames:
        yield from check_name(name, path)
        meant = nearest(name, [*cameras, *FRAMES], likeness=0.8)
        # cam2 beside cam1 is another frame, rigth beside right is a slip of the pen
        if meant is not None and name.rstrip("0123456789") != meant.rstrip("0123456789"):
            yield Fault(path, f"no camera or frame {name!r}. Did you mean {meant!r}?")


def _connect(key: str, path: str, tree: dict[str, str]) -> Iterator[Fault]:
    a, b = key.split(JOINT)
    root_a, root_b = tree.setdefault(a, a), tree.setdefault(b, b)
    if root_a == root_b:
        yield Fault(path, f"there is already a path between {a!r} and {b!r}; leave one transform out")
    tree.update({frame: root_a for frame, root in tree.items() if root == root_b})


def read(data: Mapping[str, Any]) -> dict[str, Transform]:
    """Return the transforms of data that has passed `check`, by name."""
    return {
        name: Transform(Pose(np.array(item["R"], dtype=float), item["t"]), item.get("covariance"))
        for name, item in data.items()
    }


def block(transforms: Mapping[str, Transform]) -> dict[str, Any]:
    """Return transforms as plain data."""
    return {
        name: {
            "R": item.pose.rotation.tolist(),
            "t": item.pose.translation.tolist(),
            "covariance": None if item.covariance is None else item.covariance.tolist(),
        }
        for name, item in transforms.items()
    }
