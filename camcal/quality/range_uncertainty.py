"""Uncertainty of projected points over their distance.

The projection of a direction depends on the lens alone. That of a near point depends on where the camera's centre is as
well, which the boards say, whose places are known by the same corners as the lens. A focal length that is too large
puts all boards too far away: points at their distance are projected well, nearer and farther ones are not.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, FloatArray
from camcal.calibrate.intrinsics import Calibration
from camcal.cameras.directions import in_hull, point_displacements
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.projection_uncertainty import grid_pixels

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


def range_uncertainty(calibration: Calibration) -> RangeUncertainty | None:
    """Return how uncertain the projection of points is over their distance, None where the lens is held or not known.

    The mean of what the boards of all views say about the camera's centre is taken for it, and the rotation that best
    undoes a change is taken out, see `direction_displacements`. Source: Kogan, mrcal, projection uncertainty: mean-pcam
    method.
    """
    camera = calibration.camera
    ends = np.cumsum([view.kept for view in calibration.views])
    seen = [
        (view.camera_T_board, calibration.pixels[end - view.kept : end])
        for view, end in zip(calibration.views, ends.tolist(), strict=True)
        if view.camera_T_board is not None and view.used
    ]
    width, height = camera.image_size
    pixels = grid_pixels(np.linspace(0, width - 1, _GRID[0]), np.linspace(0, height - 1, _GRID[1]))
    inside = in_hull(pixels, calibration.pixels)
    if camera.covariance is None or not camera.covariance.any() or not seen or not inside.any():
        return None
    joint = _joint_covariance(camera, seen, calibration.sigma_px)
    if joint is None:
        return None
    away = [float(np.linalg.norm(pose.translation)) for pose, _ in seen]
    distances = np.geomspace(min(away) / _BEYOND, max(away) * _BEYOND, _COUNT)
    std = []
    for distance in distances.tolist():
        moved = point_displacements(camera, pixels, distance, inside)[inside]
        moved = moved[np.isfinite(moved).all(axis=(1, 2))]
        variances = np.einsum("nij,jk,nik->n", moved, joint, moved) / 2
        std.append(np.sqrt(np.mean(variances)))
    return RangeUncertainty(distances, np.array(std), min(away), max(away))


def _joint_covariance(camera: Camera, seen: list[tuple[Pose, Array]], sigma: float) -> Array | None:
    """Return the covariance (K + 3, K + 3) of the lens parameters and of the mean shift of the boards.

    None if no view has the corners that hold a pose.

    With the lens given, the pose of a board follows it by -A⁻¹B and scatters by σ² A⁻¹, where A = JᵀJ and B = JᵀL with
    the derivatives J of its corners by the pose and L by the lens.
    """
    assert camera.covariance is not None
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
