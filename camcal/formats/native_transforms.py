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

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from camcal.formats.camera_file import Transform
from camcal.formats.covariance import why_no_covariance
from camcal.formats.schema import items, mapping, matrix, number
from camcal.formats.strict_yaml import Fault, child, nearest
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

STEP = ("tx", "ty", "tz", "rx", "ry", "rz")
JOINT = "_T_"
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
    yield from mapping({}, others=_check_one)(data, path)
    group = {}  # frame -> the frame that stands for all that are connected with it
    for key in data if isinstance(data, dict) else ():
        frames = key.split(JOINT)
        if len(frames) != 2:
            yield Fault(child(path, key), f"{key!r} is no transform: write a_T_b, which takes points in b to a")
            continue
        faults = [fault for frame in frames for fault in _check_frame(frame, child(path, key), cameras)]
        yield from faults
        if faults:
            continue
        a, b = (group.setdefault(frame, frame) for frame in frames)
        if a == b:
            what = "from a frame to itself" if frames[0] == frames[1] else "a second path between frames"
            yield Fault(child(path, key), f"{what} that are connected already; leave one transform out")
        group = {frame: a if root == b else root for frame, root in group.items()}


def _check_frame(name: str, path: str, cameras: Sequence[str]) -> Iterator[Fault]:
    yield from check_name(name, path)
    if name in cameras or name in FRAMES:
        return
    meant = nearest(name, [*cameras, *FRAMES])
    if meant is not None and len(meant) == len(name) and sorted(meant) == sorted(name):
        yield Fault(path, f"no camera or frame {name!r}. Did you mean {meant!r}?")
