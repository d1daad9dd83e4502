"""Fewer points: one for each cube of a grid, or so many drawn at random."""

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.stereo.points.vertices import NORMAL, POSITION, SIGMA

_LARGEST_KEY = 2**62


def one_per_voxel(vertices: Array, size: float) -> Array:
    """Return one vertex for each cube of a grid that holds any, in the order of the cubes.

    vertices: structured (N,), see `vertex_type`. size: side of the cubes, in the unit of x y z; (0, 0, 0) is a corner.
    A vertex is the mean of those in its cube. Of sigma it is the root of the mean square: what neighbouring pixels
    have wrong is much the same, so that a mean of many is hardly better than one.
    Raises InvalidInput unless the side is positive and the cubes can be counted.
    """
    if not (np.isfinite(size) and size > 0):
        raise InvalidInput(f"the side of a voxel must be positive, found {size:g}")
    _, cube, count = np.unique(_keys(vertices, size), return_inverse=True, return_counts=True)
    merged = np.empty(len(count), vertices.dtype)
    for name in vertices.dtype.names or ():
        column = vertices[name].astype(np.float64)
        if name == SIGMA:
            merged[name] = np.sqrt(np.bincount(cube, column**2, len(count)) / count)
        elif name not in NORMAL:
            mean = np.bincount(cube, column, len(count)) / count
            merged[name] = np.rint(mean) if vertices.dtype[name].kind == "u" else mean
    if NORMAL[0] in (vertices.dtype.names or ()):
        _merge_normals(vertices, cube, merged)
    return merged


def _keys(vertices: Array, size: float) -> Array:
    """Return a number for each vertex (N,), int64, the same for those in one cube."""
    key = np.zeros(len(vertices), np.int64)
    cubes = 1.0
    for name in POSITION:
        place = np.floor(vertices[name] / np.float32(size))
        first = place.min(initial=np.inf)
        extent = float(place.max(initial=-np.inf)) - float(first) + 1 if len(place) else 1.0
        cubes *= extent
        if not cubes < _LARGEST_KEY:
            raise InvalidInput(f"voxels of {size:g} are too many for the extent of the cloud; give a larger side")
        key *= int(extent)
        key += (place - first).astype(np.int64)
    return key


def _merge_normals(vertices: Array, cube: Array, merged: Array) -> None:
    """Write the direction of the mean normal, NaN for a cube in which none is known."""
    sums = [np.bincount(cube, np.nan_to_num(vertices[name]), len(merged)) for name in NORMAL]
    length = np.sqrt(sum(component**2 for component in sums))
    for name, component in zip(NORMAL, sums, strict=True):
        merged[name] = np.divide(component, length, out=np.full(len(merged), np.nan), where=length > 0)


def drawn(count: int, wanted: int) -> Array:
    """Return (count,) bool, True for so many drawn at random, or for all if there are no more; always the same ones.

    Raises InvalidInput if `wanted` is less than 1.
    """
    if wanted < 1:
        raise InvalidInput(f"at least one point is needed, found {wanted}")
    taken = np.ones(count, bool)
    if count > wanted:
        taken[np.random.default_rng(0).choice(count, count - wanted, replace=False, shuffle=False)] = False
    return taken
