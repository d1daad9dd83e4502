"""Reprojection: residuals of points, their derivatives, and whitening.

Long axes come last: V views of P points each are (…, V, P).
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel


@dataclass(frozen=True, eq=False)
class Reprojection:
    """Residuals (2, …) in pixels, projected minus observed and not whitened, with derivatives by the points in the
    camera frame (2, 3, …) and by the lens parameters (2, K, …). valid: (…), the points that have an image; the others
    have zeros.
    """

    residuals: Array
    by_point: Array
    by_lens: Array
    valid: Array


def residuals(model: CameraModel, parameters: Array, points: Array, pixels: Array) -> Array:
    """Return projected minus observed pixels (2, …) of points (3, …) in the camera frame, NaN outside the lens's
    domain.
    """
    projected = model.project(parameters, points.reshape(3, -1).T).pixels.T
    return np.asarray(projected.reshape(2, *points.shape[1:]) - pixels)


def linearised(
    model: CameraModel, parameters: Array, points: Array, pixels: Array, *, within_domain: bool = True
) -> Reprojection:
    """Return the residuals of points (3, …) in the camera frame against pixels (2, …), with their derivatives; by the
    lens's formula beyond its domain as well, unless points must be within it.
    """
    projected = model.project_with_jacobians(parameters, points.reshape(3, -1).T, within_domain=within_domain)
    shape = points.shape[1:]
    left = projected.pixels.T.reshape(2, *shape) - pixels
    by_point = projected.d_point.transpose(1, 2, 0).reshape(2, 3, *shape)
    by_lens = projected.d_parameters.transpose(1, 2, 0).reshape(2, -1, *shape)
    if not projected.valid.all():
        left, by_point, by_lens = (np.nan_to_num(values) for values in (left, by_point, by_lens))
    return Reprojection(left, by_point, by_lens, projected.valid.reshape(shape))


def rotated_points(rotations: Array, points: Array) -> Array:
    """Return points (3, V, P), or (3, 1, P) for all alike, turned by rotations (V, 3, 3)."""
    return np.ascontiguousarray((rotations @ points.transpose(1, 0, 2)).transpose(1, 0, 2))


def by_pose(by_point: Array, rotated: Array, out: Array | None = None) -> Array:
    """Return pixels by tx ty tz rx ry rz (2, 6, …) from d/dpoint (2, 3, …) and the rotated points R p (3, …).

    a · (δr × q) = δr · (q × a), so the rotation's part is the cross product of q with each row a. out: where to write.
    """
    result = np.empty((2, 6, *by_point.shape[2:])) if out is None else out
    result[:, :3] = by_point
    for axis, (ahead, behind) in enumerate(((1, 2), (2, 0), (0, 1))):
        np.multiply(rotated[ahead], by_point[:, behind], out=result[:, 3 + axis])
        result[:, 3 + axis] -= rotated[behind] * by_point[:, ahead]
    return result


def whitening_of(covariances: Array) -> Array:
    """Return the factors W (2, 2, V, P) with Wᵀ W the inverse of covariances (V, P, 2, 2)."""
    factors = np.linalg.cholesky(np.linalg.inv(covariances))
    return np.ascontiguousarray(factors.transpose(3, 2, 0, 1))


def whitened(whitening: Array | None, values: Array) -> Array:
    """Return values (2, …, V, P) multiplied by the whitening (2, 2, V, P), as they are without one."""
    if whitening is None:
        return values
    return np.asarray(np.stack([whitening[i, 0] * values[0] + whitening[i, 1] * values[1] for i in range(2)]))
