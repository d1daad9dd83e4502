"""Points that stand alone: by the disparities around a pixel, or by the points around a point."""

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.planes import difference

ORGANISED = "organised"
RADIUS = "radius"
NONE = "none"
METHODS = (ORGANISED, RADIUS, NONE)

NEIGHBOURS = 6  # that a point must have, of 24 around a pixel, or in the sphere around a point
REACH = 2  # pixels to all sides
_APART = 1.0  # pixels of disparity
_HALF = tuple((dy, dx) for dy in range(REACH + 1) for dx in range(-REACH, REACH + 1) if dy > 0 or dx > 0)
_SHARE_OF_DEPTH = 0.01


def has_company(disparity: Array, within: slice) -> Array:
    """Return whether at least 6 of the 5 × 5 pixels around each have a disparity within 1 px of its own, (N, W).

    disparity: (M, W) pixels, NaN where there is no match. within: the N of the M rows that are asked about; up to
    `REACH` on either side are looked at.
    """
    columns = disparity.shape[1] + 2 * REACH
    padded = np.full((len(disparity), columns), np.nan, np.float32)
    padded[:, REACH:-REACH] = disparity
    # As one row of pixels: a neighbour is then the same row further on, and is so to both of the two.
    flat = padded.reshape(1, -1)
    count = np.zeros(flat.size, np.uint8)
    apart, near = np.empty_like(flat), np.empty(flat.size, bool)
    for shift in (dy * columns + dx for dy, dx in _HALF):
        end = flat.size - shift
        if end <= 0:
            break
        difference(flat[:, shift:], flat[:, :end], apart[:, :end])
        np.less_equal(apart[0, :end], _APART, out=near[:end])
        count[:end] += near[:end].view(np.uint8)
        count[shift:] += near[:end].view(np.uint8)
    return np.asarray(count.reshape(padded.shape)[within, REACH:-REACH] >= NEIGHBOURS)


def has_neighbours(points: Array, radius: float | None = None) -> Array:
    """Return whether each of points (N, 3) has at least 6 others within a radius, by default 1 % of the median z."""
    from scipy.spatial import cKDTree  # a quarter of a second that other clouds need not wait for

    if radius is None:
        radius = _SHARE_OF_DEPTH * float(np.median(points[:, 2])) if len(points) else 1.0
    if not radius > 0:
        raise InvalidInput(f"the radius around a point must be positive, found {radius:g} m")
    if not len(points):
        return np.zeros(0, bool)
    # The nearest of all is the point itself.
    distance, _ = cKDTree(points).query(points, k=[NEIGHBOURS + 1], distance_upper_bound=radius)
    return np.asarray(np.isfinite(np.ravel(distance)))
