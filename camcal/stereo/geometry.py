"""The geometry of a rectified pair, for conversion of disparity to depth."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

_ANGLE = 1e-5  # rad; at a focal length of 1000 px this moves a row by 0.01 px
_PIXELS = 1e-2


@dataclass(frozen=True)
class StereoGeometry:
    """What turns disparity into depth: the left camera of the rectified pair and its distance to the right one.

    fx, fy, cx, cy: pixels. baseline: metres, positive. doffs: cx of the right camera minus cx of the left, pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    doffs: float = 0.0

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy", "baseline", "doffs"):
            if not np.isfinite(getattr(self, name)):
                raise InvalidInput(f"{name} must be a finite number")
        for name in ("fx", "fy", "baseline"):
            if getattr(self, name) <= 0:
                raise InvalidInput(f"{name} must be positive, found {getattr(self, name):g}")


def pinhole_intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy, pixels, of a camera without distortion; raises InvalidInput if it has any."""
    if not camera.model.is_pinhole(camera.parameters):
        raise InvalidInput(f"the camera is distorted ({camera.model.name}); undistort or rectify the images first")
    fx, fy, cx, cy = camera.parameters[:4].tolist()
    return fx, fy, cx, cy


def of_pair(left: Camera, right: Camera, right_T_left: Pose) -> StereoGeometry:
    """Return the geometry of two rectified cameras.

    Raises InvalidInput unless both are free of distortion, see along parallel axes, stand beside each other and share
    focal lengths and rows.
    """
    fx, fy, cx, cy = pinhole_intrinsics(left)
    right_fx, right_fy, right_cx, right_cy = pinhole_intrinsics(right)
    x, y, z = right_T_left.translation.tolist()
    angle = float(np.linalg.norm(so3.log(right_T_left.rotation)))
    if angle > _ANGLE or abs(y) > _ANGLE * abs(x) or abs(z) > _ANGLE * abs(x):
        raise InvalidInput(
            f"the pair is not rectified: its axes differ by {angle:.2g} rad, t = ({x:g}, {y:g}, {z:g}) m"
        )
    differences: Array = np.abs(np.subtract((right_fx, right_fy, right_cy), (fx, fy, cy)))
    if differences.max() > _PIXELS:
        raise InvalidInput(f"the pair is not rectified: fx, fy or cy differ by {differences.max():.3g} px")
    if x >= 0:
        raise InvalidInput("the right camera is left of the left one: exchange the cameras")
    return StereoGeometry(fx, fy, cx, cy, baseline=-x, doffs=right_cx - cx)
