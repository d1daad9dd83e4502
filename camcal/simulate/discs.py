"""The rims of discs, as polygons that the renderer's pen follows."""

import math

import numpy as np

from camcal.arrays import Array

SIDES = 256  # of the polygon that stands for a circle; at a radius of 50 px it is within 0.003 px of it


def rims(discs: Array) -> Array:
    """Return the edges (D · SIDES, 2, 2) of discs (D, 3 or more) x, y, radius: start and end as x, y, from x to y.

    They are polygons of the discs' area, so that what is drawn of them is neither smaller nor larger.
    """
    turn = 2 * math.pi / SIDES
    angles = turn * np.arange(SIDES + 1)
    circle = math.sqrt(turn / math.sin(turn)) * np.column_stack([np.cos(angles), np.sin(angles)])
    corners = discs[:, None, :2] + discs[:, None, 2:3] * circle
    return np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 2)
