"""How far the calibration may misplace the projection of a direction, over the image: a map and its figures.

A camera's own axes are a choice of its calibration: a rotation of all directions changes what the parameters are, not
what the camera measures. The rotation that best undoes a change of the parameters is therefore taken out.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3

GRID = (31, 23)
_FEWEST_INSIDE = 10  # pixels of the grid that a rotation is fitted to


@dataclass(frozen=True, eq=False)
class ProjectionUncertainty:
    """The uncertainty of the projection of directions (points at infinity), at the pixels of a grid over the image.

    u, v: coordinates of the columns and rows of the grid, from the centre of the first pixel to that of the last.
    covariances: (N, 2, 2) px², N = rows · columns, row by row; NaN where the lens is not valid. inside: (N,) pixels in
    the convex hull of the corners that were seen, None where they are not known.
    """

    u: Array
    v: Array
    covariances: Array
    inside: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "u", readonly(self.u, (None,), "u"))
        object.__setattr__(self, "v", readonly(self.v, (None,), "v"))
        count = len(self.u) * len(self.v)
        object.__setattr__(self, "covariances", readonly(self.covariances, (count, 2, 2), "covariances"))
        if self.inside is not None:
            object.__setattr__(self, "inside", readonly(self.inside, (count,), "inside", bool))

    @property
    def pixels(self) -> Array:
        """The pixels (N, 2) of the grid, row by row."""
        return _pixels(self.u, self.v)

    @property
    def std_rms(self) -> Array:
        """The RMS over all image directions of the standard deviation (N,), px."""
        return np.asarray(np.sqrt(np.trace(self.covariances, axis1=1, axis2=2) / 2))

    @property
    def std_worst(self) -> Array:
        """The standard deviation (N,) in the image direction in which it is largest, px."""
        a, b, c = self.covariances[:, 0, 0], self.covariances[:, 0, 1], self.covariances[:, 1, 1]
        return np.asarray(np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b)))

    def figures(self) -> dict[str, float]:
        """Return the figures of the map in px: rms_px and worst_px over the image, and inside_rms_px, inside_worst_px.

        rms_px is the RMS of std_rms, worst_px the largest std_worst; `inside` are those where corners were seen. A
        figure of no pixel is left out.
        """
        found = {}
        parts = {"": np.ones(len(self.covariances), bool), "inside_": self.inside}
        for part, mask in parts.items():
            chosen = np.isfinite(self.std_rms) & (False if mask is None else mask)
            if chosen.any():
                found[f"{part}rms_px"] = float(np.sqrt(np.mean(self.std_rms[chosen] ** 2)))
                found[f"{part}worst_px"] = float(self.std_worst[chosen].max())
        return found


def projection_uncertainty(
    camera: Camera, covariance: Array | None = None, observed: Array | None = None, grid: tuple[int, int] = GRID
) -> ProjectionUncertainty:
    """Return how uncertain the projections of directions are that a camera's covariance (K, K) leaves.

    covariance: of the lens parameters, the camera's own if None. observed: pixels (M, 2) of the corners of the
    calibration. grid: columns and rows. The rotation is the least-squares one over the pixels of the grid where corners
    were seen, all with the same weight: these the calibration has measured, and pixels to which the lens is
    extrapolated must not turn it. It is that over the whole image where corners are not known or cover less than ten
    pixels of the grid.
    Raises InvalidInput where the covariance is not known.
    """
    covariance = camera.covariance if covariance is None else covariance
    if covariance is None:
        raise InvalidInput("the projection uncertainty needs the covariance of the camera, which is not known")
    width, height = camera.image_size
    u, v = np.linspace(0, width - 1, grid[0]), np.linspace(0, height - 1, grid[1])
    pixels = _pixels(u, v)
    by_lens, by_rotation = _jacobians(camera, pixels)
    valid = np.isfinite(by_lens).all(axis=(1, 2)) & np.isfinite(by_rotation).all(axis=(1, 2))
    inside = None if observed is None else _in_hull(pixels, observed)
    fitted = valid if inside is None or np.sum(valid & inside) < _FEWEST_INSIDE else valid & inside
    rotations = _rotations(by_lens[fitted], by_rotation[fitted])
    displacements = by_lens - by_rotation @ rotations
    covariances = displacements @ covariance @ displacements.transpose(0, 2, 1)
    covariances[~valid] = np.nan
    return ProjectionUncertainty(u, v, covariances, inside)


def _pixels(u: Array, v: Array) -> Array:
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _jacobians(camera: Camera, pixels: Array) -> tuple[Array, Array]:
    """Return the derivatives of the pixels of fixed directions by the parameters (N, 2, K) and a rotation (N, 2, 3)."""
    rays = camera.unproject(pixels).directions
    projected = camera.model.project_with_jacobians(camera.parameters, rays)
    by_lens = np.array(projected.d_parameters)
    if projected.columns is not None:
        by_lens = np.zeros((len(pixels), 2, len(camera.parameters)))
        np.put_along_axis(by_lens, np.asarray(projected.columns)[:, None, :], projected.d_parameters, axis=2)
    return by_lens, np.asarray(projected.d_point @ -so3.hat(rays))  # δray = δr × ray


def _rotations(by_lens: Array, by_rotation: Array) -> Array:
    """Return the rotation (3, K) per unit of every parameter that best explains how the parameter moves the pixels."""
    if not len(by_lens):
        return np.zeros((3, by_lens.shape[2]))
    flat = by_lens.reshape(-1, by_lens.shape[2])
    return np.asarray(np.linalg.lstsq(by_rotation.reshape(-1, 3), flat, rcond=None)[0])


def _in_hull(pixels: Array, observed: Array) -> Array:
    """Return which pixels (N, 2) lie in the convex hull of others (M, 2): none if these are on one line."""
    from scipy.spatial import ConvexHull, QhullError

    if len(observed) < 3:
        return np.zeros(len(pixels), bool)
    try:
        sides = ConvexHull(observed).equations  # outward normals and offsets
    except QhullError:  # all on one line
        return np.zeros(len(pixels), bool)
    return np.asarray((pixels @ sides[:, :2].T + sides[:, 2] <= 1e-9).all(axis=1))
