"""Directions of the axes of a frame: from text such as "x forward, y left, z up", and by names of programs."""

import re
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose

_AXES = re.compile(r"\bx (\w+), y (\w+), z (\w+)")
_DIRECTIONS = {
    **dict.fromkeys(("right", "east"), (1, 0, 0)),
    **dict.fromkeys(("left", "west"), (-1, 0, 0)),
    **dict.fromkeys(("forward", "north"), (0, 0, 1)),
    **dict.fromkeys(("back", "backward", "south"), (0, 0, -1)),
    "down": (0, 1, 0),
    "up": (0, -1, 0),
}


@dataclass(frozen=True)
class Axes:
    """A habit of pointing axes. pixel_centre: where the centre of the top-left pixel is, None without pixels."""

    name: str
    words: str
    pixel_centre: float | None = None

    @property
    def directions(self) -> Array:
        """The matrix (3, 3) from these axes to x right, y down, z forward; its determinant is -1 if left-handed."""
        return _matrix(self.words)

    @property
    def left_handed(self) -> bool:
        """Whether x, y, z are those of the left hand."""
        return bool(np.linalg.det(self.directions) < 0)


CONVENTIONS = MappingProxyType(
    {
        axes.name: axes
        for axes in (
            Axes("opencv", "x right, y down, z forward", 0.0),
            Axes("colmap", "x right, y down, z forward", 0.5),
            Axes("ros_optical", "x right, y down, z forward", 0.0),  # REP 103, frames that end in _optical
            Axes("opengl", "x right, y up, z backward"),
            Axes("blender", "x right, y up, z backward"),
            Axes("nerf", "x right, y up, z backward", 0.5),  # transforms.json of nerfstudio and instant-ngp
            Axes("unity", "x right, y up, z forward"),
            Axes("ros", "x forward, y left, z up"),  # REP 103
            Axes("enu", "x east, y north, z up"),
            Axes("ned", "x north, y east, z down"),
        )
    }
)


def convention_named(name: str) -> Axes:
    """Return the convention of a name; raises InvalidInput for an unknown one."""
    if name not in CONVENTIONS:
        raise InvalidInput(f"axes {name!r} are unknown; use one of {', '.join(CONVENTIONS)}")
    return CONVENTIONS[name]


def rotation_of(frame: str) -> Array:
    """Return the rotation (3, 3) from a frame described in words to x right, y down, z forward.

    East counts as right and north as forward. A frame that says nothing of its axes, or not three that are at right
    angles and right-handed, is taken for that of a camera.
    """
    matrix = _matrix(frame)
    return matrix if np.isclose(np.linalg.det(matrix), 1.0) else np.eye(3)


def _matrix(words: str) -> Array:
    found = _AXES.search(words)
    if found is None or not all(word in _DIRECTIONS for word in found.groups()):
        return np.eye(3)
    return np.array([_DIRECTIONS[word] for word in found.groups()], dtype=np.float64).T


def change(before: Axes, after: Axes) -> Array:
    """Return the matrix (3, 3) of 0, 1 and -1 that takes coordinates along the axes before to those after."""
    return np.asarray(after.directions.T @ before.directions)


def reexpress(a_T_b: Pose, change_a: Array, change_b: Array) -> Pose:
    """Return the pose between the same two frames with other axes: a is changed by a matrix (3, 3), b by another.

    Raises InvalidInput if one changes the hand and the other does not: no rotation joins them.
    """
    if np.linalg.det(change_a) * np.linalg.det(change_b) < 0:
        raise InvalidInput("one frame would be left-handed and the other right-handed: change the axes of both")
    return Pose(change_a @ a_T_b.rotation @ change_b.T, change_a @ a_T_b.translation)


def reexpress_jacobian(change_a: Array) -> Array:
    """Return d(step after)/d(step before) as (6, 6) where frame a of a_T_b is changed by a matrix (3, 3).

    A turn is an axial vector: a mirror reverses it once more than a translation.
    """
    result = np.zeros((6, 6))
    result[:3, :3] = change_a
    result[3:, 3:] = np.linalg.det(change_a) * change_a
    return result
