"""Uncertainty of what is measured at a distance: where points are projected, and how long objects are.

The projection of a direction depends on the lens alone. That of a near point depends on where the camera's centre is as
well, which the boards say, whose places are known by the same corners as the lens. A focal length that is too large
puts all boards too far away: points at their distance are projected well, nearer and farther ones are not.
"""

from typing import TYPE_CHECKING

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.cameras.directions import (
    GRID,
    covariance_root,
    grid_pixels,
    in_hull,
    point_displacements,
    ray_displacements,
)
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.projection_uncertainty import ProjectionUncertainty, projection_uncertainty
from camcal.records import Brief
from camcal.solve.losses import student_bound

if TYPE_CHECKING:
    from camcal.calibrate.intrinsics import Calibration
    from camcal.quality.camera_comparison import Calibrated

_GRID = (15, 11)
_BEYOND = 8.0  # times the nearest and the farthest board: the ends of the distances
_COUNT = 41


@dataclass(frozen=True, eq=False)
class RangeUncertainty:
    """The RMS standard deviation (N,), px, of points at distances (N,) over the pixels where corners were seen.

    distances: in the unit of the board. near, far: of the boards.
    """

    distances: FloatArray
    std: FloatArray
    near: float
    far: float

    @property
    def best(self) -> tuple[float, float]:
        """The distance of the least uncertainty, and that, px."""
        place = int(np.argmin(self.std))
        return float(self.distances[place]), float(self.std[place])


@dataclass(frozen=True, eq=False)
class CalibrationBoards(Brief):
    """What a camera file keeps of the boards of a calibration.

    nearest, farthest: their distances, m. noise_share: of the variance of projections, what noise alone would leave;
    the rest are errors within views. shift: (3, K + 3) the covariance of the mean of what the boards say about the
    camera's centre (m) with the lens parameters and with itself, None where it is not known.
    """

    nearest: float
    farthest: float
    noise_share: float = 1.0
    shift: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.shift is not None:
            object.__setattr__(self, "shift", readonly(self.shift, (3, None), "shift"))

    @classmethod
    def of(cls, calibration: "Calibration") -> "CalibrationBoards | None":
        """Return that of a calibration, lengths in the unit of its board; None where the lens is held."""
        camera, seen = calibration.camera, _seen(calibration)
        joint = _joint_covariance(camera, seen, calibration.sigma_px)
        if joint is None:
            return None
        maps = [
            projection_uncertainty(camera, covariance, calibration.pixels).figures()
            for covariance in (calibration.noise_covariance, camera.covariance)
        ]
        noise, whole = (figures.get("inside_rms_px", figures.get("rms_px", 0.0)) for figures in maps)
        away = [float(np.linalg.norm(pose.translation)) for pose, _ in seen]
        share = min((noise / whole) ** 2, 1.0) if whole > 0 else 1.0
        return cls(min(away), max(away), share, joint[len(camera.parameters) :])


def _seen(calibration: "Calibration") -> list[tuple[Pose, Array]]:
    """Return where the boards of the views that count were, and the corners (N, 2) that were kept of each."""
    ends = np.cumsum([view.kept for view in calibration.views]).tolist()
    return [
        (view.camera_T_board, calibration.pixels[end - view.kept : end])
        for view, end in zip(calibration.views, ends, strict=True)
        if view.camera_T_board is not None and view.used
    ]


def range_uncertainty(calibration: "Calibration") -> RangeUncertainty | None:
    """Return how uncertain the projection of points is over their distance, None where the lens is held or not known.

    The mean of what the boards of all views say about the camera's centre is taken for it, and the rotation that best
    undoes a change is taken out, see `direction_displacements`. Source: Kogan, mrcal, projection uncertainty: mean-pcam
    method.
    """
    camera, seen = calibration.camera, _seen(calibration)
    width, height = camera.image_size
    pixels = grid_pixels(np.linspace(0, width - 1, _GRID[0]), np.linspace(0, height - 1, _GRID[1]))
    inside = in_hull(pixels, calibration.pixels)
    joint = _joint_covariance(camera, seen, calibration.sigma_px) if inside.any() else None
    if joint is None:
        return None
    away = [float(np.linalg.norm(pose.translation)) for pose, _ in seen]
    distances = np.geomspace(min(away) / _BEYOND, max(away) * _BEYOND, _COUNT)
    std = []
    for distance in distances.tolist():
        variances = np.trace(_projected(camera, pixels, distance, inside, joint)[inside], axis1=1, axis2=2) / 2
        std.append(np.sqrt(np.nanmean(variances)))
    return RangeUncertainty(distances, np.array(std), min(away), max(away))


def _projected(camera: Camera, pixels: Array, distance: float, fitted: Array, joint: Array) -> FloatArray:
    """Return the covariances (N, 2, 2), px², of points at a distance that are seen at pixels (N, 2); joint: that of the
    lens and the boards (K + 3, K + 3).
    """
    moved = point_displacements(camera, pixels, distance, fitted) @ covariance_root(joint)
    return np.asarray(moved @ moved.transpose(0, 2, 1))


@dataclass(frozen=True)
class ErrorSize:
    """Standard deviations of an error where a camera is known.

    std: a typical one. worst: the largest. bound: of 95 % of errors of the typical size, wider where few views
    determine it. matching: typical, by the noise of disparities, where it applies.
    """

    std: float
    worst: float
    bound: float
    matching: float | None = None

    @classmethod
    def of(cls, stds: Array, views: float, matching: Array | None = None) -> "ErrorSize | None":
        """Return that of standard deviations (N,), NaN where unknown, None of none; views: of the calibration. Their
        median is typical: of depths along the line between two cameras they grow without end.
        """
        if not np.isfinite(stds).any():
            return None
        noise = None if matching is None else float(np.nanmedian(matching))
        std = float(np.nanmedian(stds))
        bound = student_bound(max(views - 1, 1)) * float(np.hypot(std, noise or 0.0))
        return cls(std, float(np.nanmax(stds)), bound, noise)


@dataclass(frozen=True)
class CameraErrors:
    """What a calibration leaves uncertain of what a camera measures at a distance from it.

    point: px, RMS of where a point is projected that the boards of the calibration place (by_boards), or else the
    camera itself. length: m, of an object whose ends are at that distance, which is known; None where none was
    asked for, or none is in view. pixel: m, what one pixel spans there in the middle of the image.
    """

    point: ErrorSize
    by_boards: bool
    pixel: float
    length: ErrorSize | None = None


def camera_errors(
    own: "Calibrated", boards: CalibrationBoards | None, distance: float, length: float | None = None
) -> CameraErrors:
    """Return what is uncertain at a distance (m) in the part of the image that a calibration is known for.

    boards: of its calibration. length: m, of an object. Raises InvalidInput where the covariance is not known, and for
    an object of more than twice the distance.
    """
    camera = own.camera
    if camera.covariance is None or not camera.covariance.any():
        raise InvalidInput(f"{own.name} states no covariance, so that no errors follow: calibrate with camcal")
    u, v = (np.linspace(0, side - 1, count) for side, count in zip(camera.image_size, GRID, strict=True))
    pixels = grid_pixels(u, v)
    known, by_boards = own.knows(pixels), boards is not None and boards.shift is not None
    count = len(camera.parameters)
    joint = np.zeros((count + 3, count + 3))
    joint[:count, :count] = camera.covariance
    if boards is not None and boards.shift is not None:
        joint[count:], joint[:count, count:] = boards.shift, boards.shift[:, :count].T
    found = ProjectionUncertainty(u, v, _projected(camera, pixels, distance, known, joint), known)
    figures = found.figures()
    if "inside_rms_px" not in figures:
        raise InvalidInput(f"{own.name} is known nowhere in the image, so that no errors follow: calibrate it again")
    rms, worst = figures["inside_rms_px"], figures["inside_worst_px"]
    return CameraErrors(
        ErrorSize(rms, worst, student_bound(max(own.views - 1, 1)) * rms),
        by_boards,
        distance / float(np.sqrt(np.prod(camera.parameters[:2]))),
        None if length is None else ErrorSize.of(_length_stds(own, pixels[known], distance, length), own.views),
    )


def objects(rays: Array, distance: float, length: float) -> tuple[Array, Array, Array]:
    """Return objects of a length as they are seen along rays (N, 3), each across and upright: the directions along them
    (2 N, 3), and their two ends (2 N, 3), which are at a distance from the camera.

    Raises InvalidInput for a length of more than twice the distance.
    """
    half = length / (2 * distance)
    if half > 1:
        raise InvalidInput(f"an object of {length:g} m has no two ends at {distance:g} m from the camera")
    across = np.array([1.0, 0.0, 0.0]) - rays[:, :1] * rays
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    along = np.concatenate([across, np.cross(rays, across)])
    middles = np.sqrt(1 - half**2) * np.tile(rays, (2, 1))
    return along, distance * (middles - half * along), distance * (middles + half * along)


def _length_stds(own: "Calibrated", pixels: Array, distance: float, length: float) -> Array:
    """Return the standard deviations (M,), m, of lengths that are measured by the angle between their ends, NaN where
    one is not in view; pixels: (N, 2) of the middles.
    """
    camera = own.camera
    rays = camera.unproject(pixels)
    along, *ends = objects(rays.directions[rays.valid], distance, length)
    turned, seen = [], np.ones(len(along), bool)
    for points in ends:
        found = camera.project(points)
        limit = np.array(camera.image_size) - 0.5
        inside = found.valid & ((found.pixels > -0.5) & (found.pixels < limit)).all(axis=1)
        seen &= inside & own.knows(np.where(inside[:, None], found.pixels, 0.0))
        turned.append(ray_displacements(camera, points))
    by_lens = np.einsum("ni,nik->nk", along, turned[1] - turned[0])
    stds = np.linalg.norm(by_lens @ covariance_root(np.asarray(camera.covariance)), axis=1)
    return np.where(seen, stds, np.nan)


def _joint_covariance(camera: Camera, seen: list[tuple[Pose, Array]], sigma: float) -> Array | None:
    """Return the covariance (K + 3, K + 3) of the lens parameters and of the mean shift of the boards.

    None if the lens is held or not known, or no view has the corners that hold a pose.

    With the lens given, the pose of a board follows it by -A⁻¹B and scatters by σ² A⁻¹, where A = JᵀJ and B = JᵀL with
    the derivatives J of its corners by the pose and L by the lens.
    """
    if camera.covariance is None or not camera.covariance.any():
        return None
    count, used = len(camera.parameters), 0
    follows, scatter = np.zeros((3, count)), np.zeros((3, 3))
    for pose, pixels in seen:
        by_lens, by_pose = _derivatives(camera, pose, pixels)
        if np.linalg.matrix_rank(by_pose) < by_pose.shape[1]:
            continue
        inverse, used = np.linalg.inv(by_pose.T @ by_pose), used + 1
        # of what is at the camera's centre: a turn of the board about itself moves it too
        shift = np.hstack([np.eye(3), so3.hat(pose.translation)])
        follows -= shift @ inverse @ (by_pose.T @ by_lens)
        scatter += sigma**2 * shift @ inverse @ shift.T
    if not used:
        return None
    change = np.vstack([np.eye(count), follows / used])
    joint = change @ camera.covariance @ change.T
    joint[count:, count:] += scatter / used**2
    return np.asarray(joint)


def _derivatives(camera: Camera, pose: Pose, pixels: Array) -> tuple[Array, Array]:
    """Return the derivatives of a board's corners (2N, K) by the lens and (2N, 6) by its pose, step t, r."""
    rays = camera.unproject(pixels).directions
    rays = rays[np.isfinite(rays).all(axis=1)]
    normal = pose.rotation[:, 2]
    points = rays * (normal @ pose.translation / (rays @ normal))[:, None]  # corners of a plane
    found = camera.model.project_with_jacobians(camera.parameters, points)
    by_pose = np.concatenate([found.d_point, found.d_point @ -so3.hat(points - pose.translation)], axis=2)
    by_lens = found.by_parameters(len(camera.parameters))
    good = np.isfinite(by_lens).all(axis=(1, 2)) & np.isfinite(by_pose).all(axis=(1, 2))
    return by_lens[good].reshape(-1, by_lens.shape[2]), by_pose[good].reshape(-1, 6)
