"""What a calibration's covariance means for the depth of a pair: from lenses and transform to each pixel and distance.

A change of the calibration turns the ray of a fixed pixel of either camera and moves the right camera. The match then
stands for another point: its right ray has to meet the changed left ray in the column (epipolar axis) in which it was
found. To first order that is a linear map from the parameters to the depth at each pixel and distance.
"""

import numpy as np

from camcal.arrays import Array, Float32Array, FloatArray, readonly
from camcal.cameras.directions import ray_displacements
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose, point_jacobian
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import LATLON, PINHOLE

_COLUMNS, _ROWS = 13, 9  # nodes over the picture; a lens's uncertainty is smooth between them
_NEAREST = 4.0  # baselines; the parallax of what is as near is where the last node stands


@dataclass(frozen=True, eq=False)
class CalibrationError:
    """The variance of disparities that has the effect of the calibration's covariance on the depth.

    columns (C,), rows (R,): pixels of the nodes, rising. variance: (3, R, C), px², by the powers 0, 1, 2 of d + doffs,
    for latlon of `StereoGeometry.effective`: divided by its square it is the relative variance of the depth.
    """

    columns: FloatArray
    rows: FloatArray
    variance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", readonly(self.columns, (None,), "columns"))
        object.__setattr__(self, "rows", readonly(self.rows, (None,), "rows"))
        shape = (3, len(self.rows), len(self.columns))
        object.__setattr__(self, "variance", readonly(self.variance, shape, "variance"))

    @classmethod
    def of_share(cls, share: float) -> "CalibrationError":
        """Return that of a focal length times baseline known to such a standard deviation, as a share of it."""
        return cls(np.zeros(1), np.zeros(1), np.array([0.0, 0.0, share**2]).reshape(3, 1, 1))

    def variance_of(self, effective: Float32Array, rows: slice) -> Float32Array:
        """Return the variance (N, W), px², at pixels of some rows of the picture; effective: (N, W) pixels."""
        if self.variance.shape[1:] == (1, 1):
            constant, first, second = self.variance.ravel().astype(np.float32)
        else:
            down = _shares(self.rows, np.arange(rows.start, rows.stop))
            across = _shares(self.columns, np.arange(effective.shape[1])).T
            constant, first, second = ((down @ nodes @ across).astype(np.float32) for nodes in self.variance)
        return np.asarray(np.maximum(constant + effective * (first + effective * second), 0))


def _shares(nodes: Array, places: Array) -> Array:
    """Return the shares (n, N) of nodes (N,) in what lies linearly between them at places (n,)."""
    return np.column_stack([np.interp(places, nodes, unit) for unit in np.eye(len(nodes))])


@dataclass(frozen=True, eq=False)
class CalibratedPair:
    """Two cameras as they were calibrated, and how they were rectified.

    covariance: (N, N) of the left lens's parameters, the right one's, and the six of right_T_left (order tx ty tz rx ry
    rz, m and rad; see Pose.retract). rect_R_left, rect_R_right: (3, 3), from the cameras' axes to the rectified ones.
    """

    left: Camera
    right: Camera
    right_T_left: Pose
    covariance: FloatArray
    rect_R_left: FloatArray
    rect_R_right: FloatArray

    def __post_init__(self) -> None:
        count = len(self.left.parameters) + len(self.right.parameters) + 6
        object.__setattr__(self, "covariance", readonly(self.covariance, (count, count), "covariance of the pair"))


def calibration_error(pair: CalibratedPair, geometry: StereoGeometry, size: tuple[int, int]) -> CalibrationError:
    """Return what the covariance of a calibration means for the depths of its rectified pair, of (width, height).

    Raises InvalidInput if the covariance determines no depth anywhere.
    """
    width, height = size
    columns, rows = np.linspace(0, width - 1, _COLUMNS), np.linspace(0, height - 1, _ROWS)
    u, v = (grid.ravel() for grid in np.meshgrid(columns, rows))
    across, down = geometry.rays_of(columns, rows)
    rays = (across[:, None, :] + down[:, :, None]).reshape(3, -1).T
    parallaxes = np.array([0.0, 0.5, 1.0])[:, None] * geometry.focal / _NEAREST
    right = rays[:, 1 if geometry.upright else 0] - parallaxes / geometry.focal  # tan λ, seen from the right camera
    slopes = 1 + right**2 if geometry.projection == LATLON else np.ones_like(right)
    found = np.stack([_variance(pair, geometry, rays, each) for each in parallaxes[:, 0]]) / slopes**2
    known = np.asarray(np.isfinite(found).all(axis=0))
    if not known.any():
        raise InvalidInput("the covariance of the calibration determines no depth of the pair")
    powers = (parallaxes / slopes).T[:, :, None] ** np.arange(3)
    places, where = np.column_stack([u, v]), np.flatnonzero(known)
    nearest = where[np.argmin(np.linalg.norm(places[:, None] - places[None, where], axis=2), axis=1)]
    variance = np.linalg.solve(powers[nearest], found.T[nearest, :, None])[..., 0]
    return CalibrationError(columns, rows, np.asarray(variance.T.reshape(3, _ROWS, _COLUMNS), np.float64))


def _variance(pair: CalibratedPair, geometry: StereoGeometry, rays: Array, parallax: float) -> Array:
    """Return the variance (N,), px², of a parallax of points along rays (N, 3) at distance 1, in the rectified frame.

    NaN where one of the cameras does not see them.
    """
    inverse = parallax / geometry.scale
    rotation, translation = pair.right_T_left.rotation, pair.right_T_left.translation
    seen = rays @ pair.rect_R_left
    rotated = seen @ rotation.T
    point = rotated + inverse * translation
    left = ray_displacements(pair.left, seen)
    right = ray_displacements(pair.right, point)
    moved = point_jacobian(rotated)
    moved[..., :3] *= inverse
    # What the point that the left ray gives changes by, and the right ray, in the right camera's frame.
    apart = np.concatenate([rotation @ left, -right, moved], axis=2)
    column, depth = _directions(geometry, rays, point @ pair.rect_R_right.T)
    per_inverse = np.einsum("nj,j->n", column, pair.rect_R_right @ translation)
    d_inverse = -np.einsum("nj,jk,nkp->np", column, pair.rect_R_right, apart) / per_inverse[:, None]
    d_depth = np.zeros_like(d_inverse)
    d_depth[:, : left.shape[2]] = np.einsum("nj,jk,nkp->np", depth, pair.rect_R_left, left)
    step = parallax * d_depth - geometry.scale * d_inverse
    return np.asarray(np.einsum("np,pq,nq->n", step, pair.covariance, step))


def _directions(geometry: StereoGeometry, rays: Array, points: Array) -> tuple[Array, Array]:
    """Return the gradients (N, 3) of the right column by the point (N, 3), and of the depth by the left ray (N, 3).

    Both in the rectified frame. The column is the coordinate along the epipolar line, without its focal length.
    """
    along = 1 if geometry.upright else 0
    across = 1 - along
    column, depth = np.zeros_like(points), np.zeros_like(rays)
    if geometry.projection == PINHOLE:
        depth[:, 2] = 1.0
        column[:, along] = 1 / points[:, 2]
        column[:, 2] = -points[:, along] / points[:, 2] ** 2
        return column, depth
    distance = np.hypot(points[:, across], points[:, 2])
    column[:, along] = 1 / distance
    for axis in (across, 2):
        column[:, axis] = -points[:, along] * points[:, axis] / distance**3
        depth[:, axis] = rays[:, axis]
    return column, depth
