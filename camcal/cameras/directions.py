"""Displacement of the images of fixed directions under changes of the lens, up to a common rotation.

A camera's own axes are a choice of its calibration: a rotation of all directions changes what the parameters are, not
what the camera measures. The rotation that best undoes a change of the parameters is therefore taken out.
"""

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from camcal.arrays import Array, FloatArray, require_shape
from camcal.cameras.lens import CameraModel, ProjectionJacobians, Rays
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3

GRID = (31, 23)  # columns and rows of pixels over an image, at which uncertainties are stated

_FEWEST = 10  # pixels that a rotation is fitted to
_FLAT = 1e-6  # px, the width of a hull that is a line
_ROUNDING_PX = 1e-3  # of corners of a hull, in single precision
_TURNS = 4  # linear steps to the rotation between two lenses


class Camera(Protocol):
    """A lens with its parameters: what `cameras.model.Camera` has of it, which asks for its uncertainty here."""

    @property
    def model(self) -> CameraModel: ...
    @property
    def image_size(self) -> tuple[int, int]: ...
    @property
    def parameters(self) -> Array: ...
    @property
    def covariance(self) -> Array | None: ...
    def unproject(self, pixels: Array, /) -> Rays: ...


def direction_displacements(
    camera: Camera, pixels: Array, fitted: Array | None = None, distances: Array | None = None
) -> Array:
    """Return the displacements (N, 2, K), px per unit of every lens parameter, of the directions seen at pixels (N, 2).

    fitted: (N,) bool, the pixels over which the rotation is the least-squares one, all with the same weight: those that
    a calibration has measured, as pixels to which the lens is extrapolated must not turn it. It is that over all pixels
    where `fitted` is None or holds less than ten of them. distances: (N,) of points in place of directions; a rigid
    motion of them is taken out then. NaN where the lens is not valid.
    """
    by_lens, _, by_motion = _jacobians(camera, pixels, distances)
    return _without_motion(by_lens, by_motion, fitted)


def point_displacements(camera: Camera, pixels: Array, distance: float, fitted: Array | None = None) -> Array:
    """Return the displacements (N, 2, K + 3) of points that are seen at pixels (N, 2) at a distance from the camera.

    The last three columns are those per unit of a shift of the points, in the unit of `distance`; fitted, NaN: as of
    `direction_displacements`.
    """
    by_lens, by_point, by_rotation = _jacobians(camera, pixels)
    return _without_motion(np.concatenate([by_lens, by_point / distance], axis=2), by_rotation, fitted)


def ray_displacements(camera: Camera, points: Array) -> Array:
    """Return the derivatives (N, 3, K) of the rays of fixed pixels by the lens parameters, for points (N, 3) there.

    They are at right angles to the ray, for a ray as long as that of the point. NaN where the camera does not see it.
    """
    jacobians = camera.model.project_with_jacobians(camera.parameters, points)
    count = len(camera.parameters)
    result = np.full((len(points), 3, count), np.nan)
    valid = jacobians.valid
    result[valid] = -np.linalg.pinv(jacobians.d_point[valid]) @ jacobians.by_parameters(count)[valid]
    return result


def lens_difference(
    camera: Camera, other: Camera, pixels: Array, fitted: Array | None = None, distances: Array | None = None
) -> Array:
    """Return by how much (N, 2), px, another camera images the directions elsewhere that one sees at pixels (N, 2),
    after the rotation that best undoes that; fitted, distances, NaN: as of `direction_displacements`, for either lens.
    """
    points = camera.unproject(pixels).at(1.0 if distances is None else distances[:, None])
    for _ in range(_TURNS):
        found = other.model.project_with_jacobians(other.parameters, points)
        apart, by_motion = (found.pixels - pixels)[:, :, None], _by_motion(found, points, near=distances is not None)
        chosen = _select_fitted(apart, by_motion, fitted)
        step = _best_motions(apart[chosen], by_motion[chosen])[:, 0]
        points = points @ so3.exp(step[:3])  # by its inverse
        if distances is not None:
            points = points - step[3:]
    return np.asarray(_without_motion(apart, by_motion, fitted)[:, :, 0])


def camera_axes(camera: Camera, pixels: Array, fitted: Array | None = None, distances: Array | None = None) -> Array:
    """Return the displacements (N, 2, 3) of the same pixels per unit of a relative change of the focal length and per
    px by which the principal point moves right and down; fitted, distances, NaN: as of `direction_displacements`.
    """
    shift = np.broadcast_to(np.eye(2), (len(pixels), 2, 2))
    moved = np.concatenate([(pixels - camera.parameters[2:4])[:, :, None], shift], axis=2)
    return _without_motion(moved, _jacobians(camera, pixels, distances)[2], fitted)


def projection_covariances(camera: Camera, pixels: ArrayLike, observed: Array | None = None) -> FloatArray:
    """Return the covariances (N, 2, 2), px², of the projections of far points that are seen at pixels (N, 2).

    observed: pixels (M, 2) of the corners of the calibration; the rotation is that over the part of the image that they
    cover, over the whole image without them, not over `pixels`. NaN where the lens is not valid. Raises InvalidInput
    where the covariance of the camera is not known.
    """
    pixels = require_shape(pixels, (None, 2), "pixels")
    image = grid_pixels(*(np.linspace(0, side - 1, count) for side, count in zip(camera.image_size, GRID, strict=True)))
    fitted = np.ones(len(image), bool) if observed is None else in_hull(image, observed)
    fitted = np.append(fitted, np.zeros(len(pixels), bool))
    together = np.concatenate([image, pixels])
    return direction_covariances(camera, camera.covariance, together, fitted)[len(image) :]


def direction_covariances(
    camera: Camera, covariance: Array | None, pixels: Array, fitted: Array | None = None
) -> FloatArray:
    """Return the covariances (N, 2, 2), px², of the images of the directions seen at pixels (N, 2).

    covariance: (K, K) of the lens parameters. fitted, NaN: as of `direction_displacements`. Raises InvalidInput where
    the covariance is not known.
    """
    if covariance is None:
        raise InvalidInput("the projection uncertainty needs the covariance of the camera, which is not known")
    moved = direction_displacements(camera, pixels, fitted) @ covariance_root(covariance)
    return np.asarray(moved @ moved.transpose(0, 2, 1))


def covariance_root(covariance: Array) -> Array:
    """Return a root R (K, K) of a covariance R Rᵀ, by which no variance of what it moves is negative, as it may be by
    rounding where parameters are strongly correlated.
    """
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def grid_pixels(u: Array, v: Array) -> Array:
    """Return the pixels (N, 2) of a grid of columns u and rows v, row by row."""
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _by_motion(projected: ProjectionJacobians, points: Array, *, near: bool) -> Array:
    """Return the derivatives of pixels by a rotation of points (N, 2, 3), of near ones by a shift too (N, 2, 6)."""
    by_rotation = projected.d_point @ -so3.hat(points)  # δp = δr × p
    return np.concatenate([by_rotation, projected.d_point], axis=2) if near else np.asarray(by_rotation)


def _select_fitted(moved: Array, by_motion: Array, fitted: Array | None) -> Array:
    """Return the pixels (N,) bool that a motion is fitted to: see `direction_displacements`."""
    valid = np.isfinite(moved).all(axis=(1, 2)) & np.isfinite(by_motion).all(axis=(1, 2))
    return np.asarray(valid if fitted is None or np.sum(valid & fitted) < _FEWEST else valid & fitted)


def _without_motion(moved: Array, by_motion: Array, fitted: Array | None) -> Array:
    """Return displacements (N, 2, C) without what the motion explains that explains most of them."""
    chosen = _select_fitted(moved, by_motion, fitted)
    displacements = moved - by_motion @ _best_motions(moved[chosen], by_motion[chosen])
    displacements[~_select_fitted(moved, by_motion, None)] = np.nan
    return np.asarray(displacements)


def _jacobians(camera: Camera, pixels: Array, distances: Array | None = None) -> tuple[Array, Array, Array]:
    """Return the derivatives of pixels of unit rays, or of points at distances, by parameters (N, 2, K), point
    (N, 2, 3) and motion, see `_by_motion`.
    """
    points = camera.unproject(pixels).at(1.0 if distances is None else distances[:, None])
    projected = camera.model.project_with_jacobians(camera.parameters, points)
    by_motion = _by_motion(projected, points, near=distances is not None)
    return projected.by_parameters(len(camera.parameters)), projected.d_point, by_motion


def _best_motions(moved: Array, by_motion: Array) -> Array:
    """Return the motion (M, C) per unit of every change that best explains how the change moves the pixels."""
    if not len(moved):
        return np.zeros((by_motion.shape[2], moved.shape[2]))
    flat = moved.reshape(-1, moved.shape[2])
    return np.asarray(np.linalg.lstsq(by_motion.reshape(len(flat), -1), flat, rcond=None)[0])


def in_hull(pixels: Array, observed: Array) -> Array:
    """Return which pixels (N, 2) lie in the convex hull of others (M, 2): none if these are on one line."""
    from camcal.opencv import convex_hull  # here, for commands that do without OpenCV

    if len(observed) < 3:
        return np.zeros(len(pixels), bool)
    corners = observed[convex_hull(observed)]
    sides = np.roll(corners, -1, axis=0) - corners
    area = np.sum(corners[:, 0] * np.roll(corners[:, 1], -1) - corners[:, 1] * np.roll(corners[:, 0], -1))
    if np.abs(area) <= _FLAT * np.linalg.norm(sides, axis=1).sum():  # all on one line
        return np.zeros(len(pixels), bool)
    apart = pixels[:, None] - corners
    across = (sides[:, 0] * apart[..., 1] - sides[:, 1] * apart[..., 0]) / np.linalg.norm(sides, axis=1)
    return np.asarray((np.sign(area) * across >= -_ROUNDING_PX).all(axis=1))
