"""Rectification of images in ROS: a rotation R and a projection P for each camera, of one or of a pair."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

_WIDEST = np.tan(np.radians(80))  # rays farther from the axis do not count in where the view's centre lies
_SAMPLES = 9  # a side of the image
_BESIDE = 1e-3  # of the baseline, which no pair that looks along it reaches
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Rectified:
    """R (3, 3), which takes the camera's axes to the rectified ones, and P (3, 4), pixels and pixels times metres."""

    rotation: Array
    projection: Array

    @property
    def offset(self) -> Array:
        """The translation (3,), metres, by which points of the pair's rectified frame come to the camera's."""
        return np.asarray(np.linalg.solve(self.projection[:, :3], self.projection[:, 3]))

    def leaves(self, camera: Camera) -> bool:
        """Return whether R and P are those of a camera that is not rectified: R = 1, P = [K | 0]."""
        same = of_matrix(camera)
        return np.array_equal(self.rotation, same.rotation) and np.array_equal(self.projection, same.projection)

    def placed_from(self, left: "Rectified") -> Pose:
        """Return right_T_left, if this is the right camera's."""
        rotation = self.rotation.T @ left.rotation
        return Pose(rotation, self.rotation.T @ (self.offset - left.offset))


def of_one(camera: Camera) -> Rectified:
    """Return R = 1 and P = [K | 0]; of a fisheye P is that of a pinhole view, as wide as one can be without black."""
    view = camera
    if camera.model.name == "kannala_brandt4":
        from camcal.images.options import ViewOptions
        from camcal.images.views import make_view

        try:
            view = make_view(camera, ViewOptions())
        except InvalidInput:  # more than a pinhole holds
            view = camera
    return of_matrix(view)


def of_matrix(camera: Camera) -> Rectified:
    """Return R = 1 and P = [K | 0]."""
    return Rectified(np.eye(3), np.column_stack([camera.K, np.zeros(3)]))


def of_pair(left: Camera, right: Camera, right_T_left: Pose) -> tuple[Rectified, Rectified]:
    """Return R and P of both cameras: each turned by half of what lies between them, then along the baseline.

    The focal length is the smallest there is, the principal point is the same in both and centres what they see.
    """
    half = so3.exp(right_T_left.vector() / 2)
    middle_R_right = half.T
    baseline = middle_R_right @ right_T_left.translation
    align = _along_rows(baseline)
    rotations = align @ half, align @ middle_R_right
    focal = min(camera.value(name) for camera in (left, right) for name in ("fx", "fy"))
    width, height = left.image_size
    seen = np.mean([_centre(camera, turn) for camera, turn in zip((left, right), rotations, strict=True)], axis=0)
    cx, cy = (width - 1) / 2 - focal * seen[0], (height - 1) / 2 - focal * seen[1]
    matrix = np.array([(focal, 0, cx), (0, focal, cy), (0, 0, 1)])
    length = np.linalg.norm(baseline)
    offsets = np.zeros(3), length * np.round(align @ baseline / length)  # along one axis, without rounding errors
    first, second = (
        Rectified(turn, np.column_stack([matrix, matrix @ offset]))
        for turn, offset in zip(rotations, offsets, strict=True)
    )
    return first, second


def _along_rows(baseline: Array) -> Array:
    """Return the rotation (3, 3) to axes of which x, or y where the cameras stand above each other, is the baseline."""
    length = np.linalg.norm(baseline)
    if np.hypot(baseline[0], baseline[1]) <= _BESIDE * length:
        raise InvalidInput("the two cameras are at one place or behind each other: not a rectifiable pair")
    if abs(baseline[0]) >= abs(baseline[1]):
        x = baseline / length * np.copysign(1, baseline[0])
        y = np.cross(_Z, x)
        y /= np.linalg.norm(y)
    else:
        y = baseline / length * np.copysign(1, baseline[1])
        x = np.cross(y, _Z)
        x /= np.linalg.norm(x)
    return np.array([x, y, np.cross(x, y)])


def _centre(camera: Camera, rectified_R_camera: Array) -> Array:
    """Return the mean x / z, y / z (2,) of what a camera sees, in rectified axes."""
    width, height = camera.image_size
    grid = np.meshgrid(np.linspace(0, width - 1, _SAMPLES), np.linspace(0, height - 1, _SAMPLES))
    rays = camera.unproject(np.column_stack([axis.ravel() for axis in grid]))
    turned = rays.directions[rays.valid] @ rectified_R_camera.T
    near = turned[turned[:, 2] * _WIDEST > np.hypot(turned[:, 0], turned[:, 1])]
    return np.asarray((near[:, :2] / near[:, 2:]).mean(axis=0)) if len(near) else np.zeros(2)
