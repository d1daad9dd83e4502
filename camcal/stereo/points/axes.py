"""Which way the axes of a frame point, from the words that describe it: "x forward, y left, z up"."""

import re

import numpy as np

from camcal.arrays import Array

_AXES = re.compile(r"\bx (\w+), y (\w+), z (\w+)")
_DIRECTIONS = {
    **dict.fromkeys(("right", "east"), (1, 0, 0)),
    **dict.fromkeys(("left", "west"), (-1, 0, 0)),
    **dict.fromkeys(("forward", "north"), (0, 0, 1)),
    **dict.fromkeys(("back", "backward", "south"), (0, 0, -1)),
    "down": (0, 1, 0),
    "up": (0, -1, 0),
}


def rotation_of(frame: str) -> Array:
    """Return the rotation (3, 3) from a frame so described to x right, y down, z forward.

    East counts as right and north as forward. A frame that says nothing of its axes, or not three that are at right
    angles and right-handed, is taken for that of a camera.
    """
    found = _AXES.search(frame)
    if found is None or not all(word in _DIRECTIONS for word in found.groups()):
        return np.eye(3)
    rotation = np.array([_DIRECTIONS[word] for word in found.groups()], dtype=np.float64).T
    return rotation if np.isclose(np.linalg.det(rotation), 1.0) else np.eye(3)
