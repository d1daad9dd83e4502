"""Observations of many views as one table, the poses that planar ones start from, and residuals with their derivatives.

Long axes come last: V views of P points each are (…, V, P).
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from camcal.arrays import Array
from camcal.cameras.lens import CameraModel, ProjectionJacobians
from camcal.dataclass import dataclass, field, replace
from camcal.geometry import rotation as so3


@dataclass(frozen=True, eq=False)
class Reprojection:
    """Residuals (2, …) in pixels, projected minus observed and not whitened, with derivatives by the points in the
    camera frame (2, 3, …). valid: (…), the points that have an image; the others have zeros. projected: with the
    derivatives by the lens's parameters, of which there are `count`.
    """

    residuals: Array
    by_point: Array
    valid: Array
    projected: ProjectionJacobians
    count: int

    @property
    def by_lens(self) -> Array:
        """The derivatives (2, K, …) by the lens parameters: those of a spline are many."""
        found = self.projected.by_parameters(self.count).transpose(1, 2, 0).reshape(2, -1, *self.valid.shape)
        if not self.valid.all():
            found[..., ~self.valid] = 0.0  # in place: they are most of the memory that a calibration moves
        return found


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
    if not projected.valid.all():
        left, by_point = (np.nan_to_num(values) for values in (left, by_point))
    return Reprojection(left, by_point, projected.valid.reshape(shape), projected, len(parameters))


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


class DetectedPoints(Protocol):
    """What one image shows of one body: points ids (N,) at pixels (N, 2), with covariances (N, 2, 2) px² or None."""

    @property
    def ids(self) -> Array: ...
    @property
    def pixels(self) -> Array: ...
    @property
    def covariance(self) -> Array | None: ...
    @property
    def camera(self) -> str | None: ...
    @property
    def body(self) -> str: ...
    @property
    def time(self) -> float | None: ...


@dataclass(frozen=True, eq=False)
class Observations:
    """Pixels of points of bodies in V views, padded to P rows a view.

    ids: (V, P). pixels: (2, V, P). weights: (V, P), 0 for padding and for what is rejected, else at most 1.
    whitening: (2, 2, V, P) with Wᵀ W the inverse covariance of a pixel over a typical one's, or None: all alike.
    present: (V, P), the points that there are, whatever their weight; by default those of a weight above 0.
    covariance: (V, P, 2, 2) px², as the images give it, None: all alike. camera, body: (V,) places in the names cameras
    and bodies. time: (V,) s, NaN where unknown.
    """

    ids: Array
    pixels: Array
    weights: Array
    whitening: Array | None = None
    present: Array = field(default_factory=lambda: np.zeros(0, np.bool_))
    covariance: Array | None = None
    camera: Array = field(default_factory=lambda: np.zeros(0, np.intp))
    body: Array = field(default_factory=lambda: np.zeros(0, np.intp))
    time: Array = field(default_factory=lambda: np.zeros(0))
    cameras: tuple[str, ...] = ("",)
    bodies: tuple[str, ...] = ("",)

    def __post_init__(self) -> None:
        count = len(self.ids)
        columns = {
            "present": self.weights > 0,
            "camera": np.zeros(count, np.intp),
            "body": np.zeros(count, np.intp),
            "time": np.full(count, np.nan),
        }
        for name, default in columns.items():
            if not getattr(self, name).size:
                object.__setattr__(self, name, default)

    @classmethod
    def of(cls, views: Sequence[DetectedPoints | None], unknown: Array | None = None) -> "Observations":
        """Return the table of the points in `views`, a row of the table for each, all points counting the same.

        None is a view of nothing. unknown: (2, 2) px², the covariance of points whose view gives none where another one
        does; None: that of the typical one of the others.
        """
        counts = np.array([0 if view is None else len(view.pixels) for view in views])
        shape = len(views), max(int(counts.max(initial=0)), 1)
        present = np.arange(shape[1]) < counts[:, None]
        ids, pixels = np.zeros(shape, np.intp), np.zeros((2, *shape))
        known = [view.covariance for view in views if view is not None and view.covariance is not None]
        covariance = None
        if known:
            typical = np.median(np.concatenate(known), axis=0) if unknown is None else unknown
            covariance = np.tile(typical, (*shape, 1, 1))
        for row, view in enumerate(views):
            if view is None or not counts[row]:
                continue
            ids[row, : counts[row]] = view.ids
            pixels[:, row, : counts[row]] = view.pixels.T
            pixels[:, row, counts[row] :] = view.pixels[0, :, None]  # one that the lens knows
            if covariance is not None and view.covariance is not None:
                covariance[row, : counts[row]] = view.covariance
        cameras, camera = _numbered([(view and view.camera) or "" for view in views])
        bodies, body = _numbered([view.body if view else "" for view in views])
        times = [view.time if view else None for view in views]
        return cls(
            ids,
            pixels,
            present.astype(float),
            present=present,
            covariance=covariance,
            camera=camera,
            body=body,
            time=np.array([np.nan if time is None else time for time in times]),
            cameras=cameras,
            bodies=bodies,
        )

    def padded(self, columns: Sequence[Array | None], size: int) -> Array:
        """Return `size` values (N, D) of the points of every view, None of a view of nothing, as a table (D, V, P)."""
        result = np.zeros((size, *self.ids.shape))
        for row, column in enumerate(columns):
            if column is not None:
                result[:, row, : len(column)] = column.T
        return result

    def weighted(self, covariances: Array) -> "Observations":
        """Return the table with points that count by their covariances (V, P, 2, 2) px², relative to the typical one.

        Residuals stay in pixels, those of a typical point: one with the geometric mean of all variances.
        """
        typical = np.exp(np.log(np.linalg.det(covariances[self.weights > 0])).mean() / 2)
        return replace(self, whitening=whitening_of(covariances / typical))

    def alike(self) -> "Observations":
        """Return the table with all points that there are counting the same."""
        return replace(self, weights=self.present.astype(float), whitening=None, covariance=None)

    def take(self, views: Array) -> "Observations":
        """Return the table of some of the views."""
        return replace(
            self,
            ids=self.ids[views],
            pixels=self.pixels[:, views],
            weights=self.weights[views],
            whitening=None if self.whitening is None else self.whitening[:, :, views],
            present=self.present[views],
            covariance=None if self.covariance is None else self.covariance[views],
            camera=self.camera[views],
            body=self.body[views],
            time=self.time[views],
        )


def _numbered(names: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """Return the different names, in the order in which they come first, and the place of each name among them."""
    places = {name: place for place, name in enumerate(dict.fromkeys(names))}
    return tuple(places), np.array([places[name] for name in names], np.intp)


_HELD = 1e-12  # keeps points on a single ray, whose distance is open, from being singular


def planar_poses(rays: Array, points: Array, mask: Array) -> tuple[Array, Array]:
    """Return camera_T_plane, rotations (W, 3, 3) and translations (W, 3), of planes z = 0.

    rays: (3, W, N) unit, through points (3, W, N) of the planes where the mask (W, N) is True; what points have of z is
    left out. Points that spread by about 1 around the origin leave the least errors.
    A plane's points p and their rays d obey d × (H p) = 0; the 3 × 3 matrix H of least algebraic error holds the
    first two columns of the rotation and the translation. Works for rays behind the image plane as well.
    Source: Hartley & Zisserman, Multiple View Geometry, 2nd ed., section 4.1, with rays in place of pixels.
    """
    present = mask.astype(float)
    flat = np.stack([points[0] * present, points[1] * present, present])
    # ‖d × v‖² = v · (I - d dᵀ) v for unit d, so the normal matrix needs only these two Gram matrices
    plain = np.einsum("awn,bwn->wab", flat, flat)
    mixed = (rays[:, None] * flat[None]).reshape(9, *mask.shape).transpose(1, 0, 2)
    normal = np.einsum("ij,wab->wiajb", np.eye(3), plain).reshape(-1, 9, 9) - mixed @ mixed.transpose(0, 2, 1)
    homographies = np.linalg.eigh(normal)[1][:, :, 0].reshape(-1, 3, 3)
    size = np.linalg.norm(homographies[:, :, :2], axis=1).mean(axis=1)
    first = homographies[:, :, :2] / np.maximum(size, np.finfo(float).tiny)[:, None, None]
    turns = so3.nearest(np.concatenate([first, np.cross(first[:, :, 0], first[:, :, 1])[..., None]], axis=2))
    # the sign of the homography is open, and with it that of the first two columns
    other = turns * [-1, -1, 1]
    front, behind = (_translations(rays, flat, each) for each in (turns, other))
    placed = np.concatenate([turns[:, :, :2], front[:, :, None]], axis=2)
    wrong = np.einsum("iwn,wij,jwn->w", rays, placed, flat) <= 0
    return np.where(wrong[:, None, None], other, turns), np.where(wrong[:, None], behind, front)


def affine_poses(places: Array, points: Array, mask: Array) -> tuple[Array, Array, Array]:
    """Return camera_T_plane, rotations (W, 3, 3) and translations (W, 3), of planes z = 0 under parallel projection,
    and how large (W,) they appear.

    places: (2, W, N) across the axis, of points (3, W, N) of the planes where the mask (W, N) is True. A plane shrinks
    by the cosine of its tilt in one direction: the affine map from it has the singular values s and s cos θ. Whether
    it is tilted by θ or by -θ about the other direction no image says: it is by θ here. All stand at Z = 0.
    """
    present = mask.astype(float)
    flat = np.stack([points[0] * present, points[1] * present, present])
    seen = np.einsum("awn,bwn->wab", places * present, flat)
    maps = seen @ np.linalg.pinv(np.einsum("awn,bwn->wab", flat, flat))
    left, sizes, right = np.linalg.svd(maps[:, :, :2])
    facing = np.linalg.det(left) * np.linalg.det(right)  # -1 for a plane that is seen from behind
    cosine = facing * sizes[:, 1] / np.maximum(sizes[:, 0], np.finfo(float).tiny)
    sine = np.sqrt(1 - cosine**2)
    first, lean, last = (np.tile(np.eye(3), (len(maps), 1, 1)) for _ in range(3))
    first[:, :2, :2], last[:, :2, :2] = left, right
    first[:, :, 1] *= np.linalg.det(left)[:, None]
    last[:, 1] *= np.linalg.det(right)[:, None]
    lean[:, 1:, 1:] = np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)
    return first @ lean @ last, np.pad(maps[:, :, 2], ((0, 0), (0, 1))), sizes[:, 0]


def _translations(rays: Array, flat: Array, rotations: Array) -> Array:
    """Return the translations (W, 3) that bring points, turned by rotations (W, 3, 3), nearest to their rays.

    flat: (3, W, N) x, y, 1 of the points, 0 for those that are not there.
    """
    turned = (rotations[:, :, :2] @ flat[:2].transpose(1, 0, 2)).transpose(1, 0, 2)
    along = np.sum(rays * turned, axis=0) * rays
    across = np.einsum("ij,wn->wij", (1 + _HELD) * np.eye(3), flat[2]) - np.einsum(
        "iwn,jwn,wn->wij", rays, rays, flat[2]
    )
    return np.asarray(-np.linalg.solve(across, (turned - along).sum(axis=2).T[..., None])[..., 0])
