"""Vertices of point clouds as records without padding, in blocks, so that no cloud need be in memory as a whole."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from camcal.arrays import Array

POSITION = ("x", "y", "z")
COLOUR = ("red", "green", "blue")
NORMAL = ("nx", "ny", "nz")
INTENSITY = "intensity"
SIGMA = "sigma"

METRES = "m"
LEFT_CAMERA = "left camera: x right, y down, z forward"


def vertex_type(
    *, colour: bool = False, intensity: bool = False, normals: bool = False, sigma: bool = False
) -> np.dtype[np.void]:
    """Return the record of one vertex: x y z, then what else it has, in the order in which files hold it.

    x y z: float32. red green blue: uint8. intensity: float32, 0 … 1. nx ny nz: float32, of length 1. sigma: float32,
    standard deviation of the depth, in the unit of x y z.
    """
    fields = [(name, "<f4") for name in POSITION]
    if colour:
        fields += [(name, "u1") for name in COLOUR]
    if intensity:
        fields.append((INTENSITY, "<f4"))
    if normals:
        fields += [(name, "<f4") for name in NORMAL]
    if sigma:
        fields.append((SIGMA, "<f4"))
    return np.dtype(fields)


@dataclass(frozen=True, eq=False)
class VertexStream:
    """A point cloud on its way to a file.

    count: number of vertices, known before the first. type: their record, see `vertex_type`. blocks: structured arrays
    (N,) of that type which together hold `count`; can be gone through once. unit: m or mm. frame: in words. notes:
    more that files with room for comments carry, such as fx and the baseline. grid: (width, height) if the vertices
    are the pixels of an image, row by row, with NaN where there is no point; None otherwise.
    """

    count: int
    type: np.dtype[np.void]
    blocks: Iterable[Array]
    unit: str = METRES
    frame: str = LEFT_CAMERA
    notes: dict[str, str] = field(default_factory=dict)
    grid: tuple[int, int] | None = None
