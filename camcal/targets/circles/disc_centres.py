"""Where the centres of discs are in an image: not where the centres of their ellipses are.

Perspective moves the centre of the ellipse away from the projected centre of the disc. Where the board is seen as
x → p + J x / (1 + l · x) around a disc of radius r the offset is -r² J l / (1 - r² l · l): the centre of the dual conic
H diag(r², r², -1) Hᵀ (Heikkilä 2000, Geometric camera calibration using circular control points). Lens distortion moves
it too. Both follow from how the grid as a whole is seen (board_map.py): every disc's rim is taken into the image, an
ellipse is fitted to it as one was to the image, and its distance from the image of the centre is taken off.
"""

import numpy as np

from camcal.arrays import Array
from camcal.targets.board_map import BoardMap, map_of
from camcal.targets.circles.blobs import Ellipses, square_roots
from camcal.targets.circles.disc_edge import rim

_RIM_POINTS = 24
_ROUNDS = 3  # the map is fitted to centres that are off at first; each round leaves a quarter or less
_TYPICAL_RADIUS = 0.3  # pitches


def projected_centres(ellipses: Ellipses, points: Array, radius: float | None, size: tuple[int, int]) -> Array:
    """Return the pixels (N, 2) of the discs' centres, from their ellipses in the image.

    points: (N, 2) of the centres on the board. radius: in the same unit, None to find it from the ellipses' areas.
    size: (width, height) of the image.
    """
    centres = ellipses.centres
    for _ in range(_ROUNDS):
        seen = map_of(points, centres, size)
        reach = radius or _radius(seen, points, ellipses)
        centres = ellipses.centres - (_rims(seen, points, reach).centres - seen.pixels(points))
    return centres


def _radius(seen: BoardMap, points: Array, ellipses: Ellipses) -> float:
    """Return the radius of the discs in the points' unit: the median over what their areas say."""
    trial = _TYPICAL_RADIUS * float(np.linalg.norm(points[1:] - points[:-1], axis=1).min())
    return trial * float(np.sqrt(np.median(ellipses.areas / _rims(seen, points, trial).areas)))


def _rims(seen: BoardMap, points: Array, radius: float) -> Ellipses:
    """Return the ellipses that fit the images of the discs' rims best, every piece of a rim counting by its length."""
    angles = 2 * np.pi * np.arange(_RIM_POINTS) / _RIM_POINTS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    traced = seen.pixels(points[:, None] + radius * unit)
    lengths = np.linalg.norm(np.roll(traced, -1, axis=1) - np.roll(traced, 1, axis=1), axis=2)
    centres = traced.mean(axis=1)
    first = 2 / _RIM_POINTS * traced.swapaxes(1, 2) @ unit  # the first harmonic, an affine map of the circle
    axes = square_roots(first @ first.swapaxes(1, 2))
    x, y = np.moveaxis(traced - centres[:, None], -1, 0)
    near = rim(x, y, axes)
    (normal_x, normal_y), (across, down) = near.outward.swapaxes(0, 1), near.unit.swapaxes(0, 1)
    design = [normal_x, normal_y, normal_x * across, normal_x * down + normal_y * across, normal_y * down]
    jacobian = np.stack(design, axis=1)
    weighted = jacobian * lengths[:, None]
    normal = weighted @ jacobian.swapaxes(1, 2)
    step = np.linalg.solve(normal, weighted @ near.distance[..., None])[..., 0]
    return Ellipses(centres + step[:, :2], axes + step[:, [2, 3, 3, 4]].reshape(-1, 2, 2))
