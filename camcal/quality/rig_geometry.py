"""What a rig can measure: baseline, vergence, common field of view, and depth error against distance.

A point is triangulated from its pixels in two cameras, whatever their lenses. With J the derivatives of its pixels by
the point, the error of the point is (JᵀJ)⁻¹Jᵀ times that of the pixels: of those from matching noise, or of those from
errors of the calibration, J_θ δθ with its covariance. What of the pixels' error no point explains is the epipolar one.
Source: Hartley and Zisserman, Multiple View Geometry, 2nd edition, sections 5.2 and 12.6.
"""

from collections.abc import Mapping, Sequence
from math import inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, BoolArray, FloatArray
from camcal.cameras.model import Camera, Rig
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Derived, Pose, point_jacobian
from camcal.quality.range_uncertainty import ErrorSize, objects

DISPARITY_PX = 0.25  # standard deviation of the disparity of a usual match
BASELINES = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # distances of a table, times the baseline
_FAR = 1e6  # baselines, for infinity
_GRID = (24, 18)  # pixels of an image that are followed
_SINGULAR = 1e12  # condition of JᵀJ, in units of the distance, above which a point has no depth


class Measured(NamedTuple):
    """A value and its standard deviation, None where that is not known."""

    value: float
    std: float | None


def baseline(pose: Pose, covariance: Array | None) -> Measured:
    """Return the distance between the origins of a pose's frames, m; covariance: (6, 6) of its step."""
    length = float(np.linalg.norm(pose.translation))
    if covariance is None or length == 0:
        return Measured(length, None)
    along = pose.translation / length
    return Measured(length, float(np.sqrt(along @ covariance[:3, :3] @ along)))


def rotation_angle(pose: Pose, covariance: Array | None) -> Measured:
    """Return the angle of a pose's rotation, rad; covariance: (6, 6) of its step."""
    vector = pose.vector()
    angle = float(np.linalg.norm(vector))
    if covariance is None or angle == 0:
        return Measured(angle, None)
    axis = vector / angle  # the inverse Jacobian of the logarithm leaves the axis as it is
    return Measured(angle, float(np.sqrt(axis @ covariance[3:, 3:] @ axis)))


@dataclass(frozen=True)
class DepthError:
    """Standard deviations of the distance of points that are so far (m) from the first camera, m, each the median over
    the common field; None where it is not known, or no point is in both images.

    matching: by the noise of a disparity. calibration: by the covariance of the calibration. common: share of the first
    camera's image whose points at this distance are in the second one's.
    """

    distance: float
    matching: float | None
    calibration: float | None
    common: float


@dataclass(frozen=True, eq=False)
class PairGeometry:
    """What two cameras of a rig make together; second_T_first, and its covariance (6, 6) where it is known.

    vergence: angle between the optical axes, rad. converging: whether they come nearer to each other along the
    baseline. common: shares of the first and of the second camera's image that the other one sees at infinity.
    epipolar_px: median over the common field of the standard deviation of the distance of a pixel from the epipolar
    line of its counterpart, by the covariance of the calibration; None where that is not known.
    """

    first: str
    second: str
    pose: Pose
    covariance: FloatArray | None
    baseline: Measured
    rotation: Measured
    vergence: float
    converging: bool
    common: tuple[float, float]
    depths: tuple[DepthError, ...]
    epipolar_px: float | None


def pair_geometry(
    rig: Rig,
    first: str,
    second: str,
    baselines: Sequence[float] = BASELINES,
    disparity_px: float = DISPARITY_PX,
    circles: Mapping[str, ImageCircle] = MappingProxyType({}),
) -> PairGeometry:
    """Return what two cameras of a rig make together; baselines: distances for the depth errors, times the baseline.

    disparity_px: standard deviation of the difference of a point's pixels in the two images. circles: image circles of
    cameras, by their names, beyond which they see nothing.
    """
    pair = _Pair.of(rig, first, second, circles)
    length = baseline(pair.pose, pair.pose_covariance)
    far = _FAR * max(length.value, 1e-6)
    errors = [_errors(pair, times * length.value, disparity_px) for times in baselines] if length.value > 0 else []
    axis, other = np.array([0.0, 0.0, 1.0]), pair.pose.rotation[2]  # of the second camera, in the first one's frame
    across = pair.pose.inverse().translation
    known = [own.epipolar for own in errors if own.epipolar is not None]
    return PairGeometry(
        first,
        second,
        pair.pose,
        pair.pose_covariance,
        length,
        rotation_angle(pair.pose, pair.pose_covariance),
        vergence=float(np.arctan2(np.linalg.norm(np.cross(axis, other)), axis @ other)),
        converging=bool((other - axis) @ across < 0),
        common=(_common(pair, far)[1], _common(pair.swapped(), far)[1]),
        depths=tuple(own.depth for own in errors),
        epipolar_px=float(np.median(known)) if known else None,
    )


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two cameras, second_T_first, and the covariance (K1 + K2 + 6, …) of their parameters and its step, if known."""

    cameras: tuple[Camera, Camera]
    pose: Pose
    covariance: FloatArray | None
    circles: tuple[ImageCircle | None, ImageCircle | None] = (None, None)

    @classmethod
    def of(cls, rig: Rig, first: str, second: str, circles: Mapping[str, ImageCircle]) -> "_Pair":
        """Return two cameras of a rig."""
        cameras = rig.cameras[first], rig.cameras[second]
        steps = [Derived.of(name, rig.rig_T_camera[name].inverse()) for name in (first, second)]
        derived = steps[1] @ steps[0].inverse()
        known = circles.get(first), circles.get(second)
        if rig.covariance is None:
            return cls(cameras, derived.pose, None, known)
        counts = [len(camera.parameters) for camera in cameras]
        jacobian = np.zeros((sum(counts) + 6, len(rig.covariance)))
        for start, name, count in zip((0, counts[0]), (first, second), counts, strict=True):
            rows = rig.rows(name)
            jacobian[start : start + count, rows.start : rows.start + count] = np.eye(count)
            jacobian[-6:, rows.stop - 6 : rows.stop] += derived.by[name]
        return cls(cameras, derived.pose, np.asarray(jacobian @ rig.covariance @ jacobian.T), known)

    @property
    def pose_covariance(self) -> FloatArray | None:
        """The covariance (6, 6) of the step of second_T_first."""
        return None if self.covariance is None else self.covariance[-6:, -6:]

    def swapped(self) -> "_Pair":
        """Return the pair the other way round, without a covariance."""
        return _Pair(self.cameras[::-1], self.pose.inverse(), None, self.circles[::-1])


class _Errors(NamedTuple):
    depth: DepthError
    epipolar: float | None


def _common(pair: _Pair, distance: float) -> tuple[Array, float]:
    """Return the points (N, 3) of the first camera's image at a distance from it that are in the second one's, and
    which share of its image that is.
    """
    width, height = pair.cameras[0].image_size
    u, v = np.meshgrid(*(np.linspace(0, side - 1, count) for side, count in zip((width, height), _GRID, strict=True)))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    own = pair.circles[0]
    rays = pair.cameras[0].unproject(pixels if own is None else pixels[own.contains(pixels)])
    points = distance * rays.directions[rays.valid]
    inside = _seen(pair, 1, pair.pose.apply(points))
    return points[inside], float(inside.sum() / max(len(points), 1))


def _seen(pair: _Pair, index: int, points: Array) -> BoolArray:
    """Return which points (N, 3) in the frame of one of the cameras are in its image."""
    camera, circle = pair.cameras[index], pair.circles[index]
    seen = camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = seen.valid & ((seen.pixels > -0.5) & (seen.pixels < np.array(camera.image_size) - 0.5)).all(axis=1)
    return inside if circle is None else np.asarray(inside & circle.contains(seen.pixels))


def _errors(pair: _Pair, distance: float, disparity_px: float) -> _Errors:
    """Return the depth errors of points at a distance, and the epipolar error of the calibration, px."""
    points, common = _common(pair, distance)
    none = _Errors(DepthError(distance, None, None, common), None)
    if not len(points):
        return none
    by_point, by_calibration, gain = _triangulated(pair, points)
    sound = np.isfinite(gain).all(axis=(1, 2))
    if not sound.any():
        return none
    points, by_point, by_calibration, gain = points[sound], by_point[sound], by_calibration[sound], gain[sound]
    along = points / np.linalg.norm(points, axis=1, keepdims=True)
    by_pixels = np.einsum("ni,nij->nj", along, gain)  # of the distance, by the four pixel coordinates
    # a disparity is the difference of two coordinates with equal errors
    matching = np.linalg.norm(by_pixels, axis=1) * disparity_px / np.sqrt(2)
    depth = DepthError(distance, float(np.median(matching)), None, common)
    if pair.covariance is None:
        return _Errors(depth, None)
    by_parameters = np.einsum("nj,njk->nk", by_pixels, by_calibration)
    calibration = np.sqrt(_variances(by_parameters, pair.covariance))
    across = np.linalg.svd(by_point)[0][:, :, 3]  # what of four coordinates no point explains
    missed = _variances(np.einsum("nj,njk->nk", across, by_calibration), pair.covariance)
    # of one image, the pixel of the other held: coordinates of both share the misfit
    shares = np.linalg.norm(across[:, 2:], axis=1)
    depth = DepthError(distance, depth.matching, float(np.median(calibration)), common)
    return _Errors(depth, float(np.median(np.sqrt(missed) / np.maximum(shares, 1e-9))))


def _triangulated(pair: _Pair, points: Array) -> tuple[Array, Array, Array]:
    """Return the two results of `_derivatives` for points, and the derivatives (N, 3, 4) of triangulated points by
    their pixels, NaN where these determine none.
    """
    by_point, by_calibration = _derivatives(pair, points)
    normal = by_point.transpose(0, 2, 1) @ by_point
    sound = np.isfinite(by_calibration).all(axis=(1, 2)) & np.isfinite(normal).all(axis=(1, 2))
    sound[sound] = np.linalg.cond(normal[sound]) < _SINGULAR
    gain = np.full((len(points), 3, 4), np.nan)
    gain[sound] = np.linalg.solve(normal[sound], by_point[sound].transpose(0, 2, 1))
    return by_point, by_calibration, gain


@dataclass(frozen=True)
class PairErrors:
    """What is uncertain of what two cameras measure at a distance from the first: of the distance of points (depth) and
    of the length of an object, m; None where nothing is in both images, or no length was asked for.
    """

    first: str
    second: str
    depth: ErrorSize | None
    length: ErrorSize | None


def pair_errors(
    rig: Rig,
    first: str,
    second: str,
    distance: float,
    length: float | None = None,
    views: float = inf,
    circles: Mapping[str, ImageCircle] = MappingProxyType({}),
) -> PairErrors:
    """Return what the covariance of a rig leaves uncertain at a distance (m), and what the noise of disparities does.

    views: of the calibration; the others as of `pair_geometry`. Raises InvalidInput where the covariance is not known,
    and for an object of more than twice the distance.
    """
    pair = _Pair.of(rig, first, second, circles)
    if pair.covariance is None:
        raise InvalidInput(f"{first} and {second}: no covariance of where they stand, so that no errors follow")
    points = _common(pair, distance)[0]
    rays = points / distance
    depth = _stds(pair, ((points, rays),))
    if length is None:
        return PairErrors(first, second, ErrorSize.of(depth[0], views, depth[1]), None)
    along, *ends = objects(rays, distance, length)
    seen = np.logical_and.reduce([_seen(pair, 0, each) & _seen(pair, 1, pair.pose.apply(each)) for each in ends])
    parts = [(each[seen], sign * along[seen]) for each, sign in zip(ends, (-1.0, 1.0), strict=True)]
    sizes = [ErrorSize.of(stds, views, noise) for stds, noise in (depth, _stds(pair, parts))]
    return PairErrors(first, second, *sizes)


def _stds(pair: _Pair, parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the standard deviations (N,) of Σ a · p over parts, of triangulated points p (N, 3) along directions a
    (N, 3): by the calibration, which they share, and by the noise of disparities, which they do not.
    """
    by_parameters, squares = np.zeros((1, 1)), np.zeros(1)
    for points, along in parts:
        _, by_calibration, gain = _triangulated(pair, points)
        by_pixels = np.einsum("ni,nij->nj", along, gain)
        by_parameters = by_parameters + np.einsum("nj,njk->nk", by_pixels, by_calibration)
        squares = squares + np.sum(by_pixels**2, axis=1) * DISPARITY_PX**2 / 2
    return np.sqrt(_variances(by_parameters, np.asarray(pair.covariance))), np.sqrt(squares)


def _variances(jacobian: Array, covariance: Array) -> Array:
    return np.asarray(np.maximum(np.einsum("nk,kl,nl->n", jacobian, covariance, jacobian), 0.0))


def _derivatives(pair: _Pair, points: Array) -> tuple[Array, Array]:
    """Return the derivatives of the pixels (N, 4) of points in both images by the points (N, 4, 3) and by the
    parameters of both cameras and the step of second_T_first (N, 4, K1 + K2 + 6).
    """
    counts = [len(camera.parameters) for camera in pair.cameras]
    by_point, by_calibration = np.zeros((len(points), 4, 3)), np.zeros((len(points), 4, sum(counts) + 6))
    rotated = points @ pair.pose.rotation.T
    places = points, rotated + pair.pose.translation
    for index, (camera, place) in enumerate(zip(pair.cameras, places, strict=True)):
        found = camera.model.project_with_jacobians(camera.parameters, place)
        rows, start = slice(2 * index, 2 * index + 2), index * counts[0]
        by_calibration[:, rows, start : start + counts[index]] = found.by_parameters(counts[index])
        by_point[:, rows] = found.d_point if index == 0 else found.d_point @ pair.pose.rotation
        if index == 1:
            by_calibration[:, rows, -6:] = found.d_point @ point_jacobian(rotated)
    return by_point, by_calibration
