"""The disparity of a rectified pair: a map with uncertainty and confidence, and what turns it into distance.

And the limits: of pairs that can be matched and of maps that can be used.

About the baseline as axis a point has a distance ρ from the baseline's line, an angle φ about it (0 on the optical
axis) and an angle λ off the plane perpendicular to it. A picture shows λ or what belongs to it along its epipolar
lines, φ or Y / Z across them.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Array, Float32Array, FloatArray, readonly
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.records import Brief
from camcal.stereo.rectify.record import AXES, LATLON, MODELS, PINHOLE, PROJECTIONS, Rectification

BESIDE, BELOW = AXES
_VIEWS = {model: view for view, model in MODELS.items() if view[0] != PINHOLE}  # what a lens model is as a view

_ANGLE = 1e-5  # rad; at a focal length of 1000 px this moves a row by 0.01 px
_PIXELS = 1e-2


@dataclass(frozen=True)
class StereoGeometry(Brief):
    """What turns disparity into distance: the left camera of a rectified pair and its distance to the right one.

    fx, fy, cx, cy: pixels, of angles pixels per radian. baseline: metres, positive. doffs: principal point of the right
    camera minus that of the left one along the epipolar lines, pixels. projection: pinhole; cylindrical, with φ across
    the epipolar lines; or latlon, with φ across and λ along them. axis: x of a pair whose epipolar lines are rows, y of
    one whose epipolar lines are columns: then "left" is the upper camera and "right" the lower one.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    doffs: float = 0.0
    projection: str = PINHOLE
    axis: str = BESIDE

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy", "baseline", "doffs"):
            if not np.isfinite(getattr(self, name)):
                raise InvalidInput(f"{name} must be a finite number")
        for name in ("fx", "fy", "baseline"):
            if getattr(self, name) <= 0:
                raise InvalidInput(f"{name} must be positive, found {getattr(self, name):g}")
        for name, known in (("projection", PROJECTIONS), ("axis", AXES)):
            if getattr(self, name) not in known:
                raise InvalidInput(f"{name} {getattr(self, name)!r} is unknown; use one of {', '.join(known)}")

    @property
    def upright(self) -> bool:
        """Whether the epipolar lines are columns."""
        return self.axis == BELOW

    @property
    def focal(self) -> float:
        """Pixels along the epipolar lines."""
        return self.fy if self.upright else self.fx

    @property
    def scale(self) -> float:
        """What a parallax of one pixel is divided into, metres times pixels: focal length times baseline."""
        return self.focal * self.baseline

    def rays(self, shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
        """Return the parts by column (3, W) and by row (3, H) of the points at distance 1, for a picture of (H, W).

        A pixel's point at distance 1 is the sum of both, in the frame of the rectified left camera. The distance is z
        along the optical axis for pinhole, that from the baseline's line otherwise.
        """
        height, width = shape
        return self.rays_of(np.arange(width), np.arange(height))

    def rays_of(self, u: Array, v: Array) -> tuple[FloatArray, FloatArray]:
        """Return the same for some columns u (W,) and rows v (H,), pixels."""
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        columns, rows = np.zeros((3, len(u))), np.zeros((3, len(v)))
        along, across = (y, x) if self.upright else (x, y)
        first, second = (rows, columns) if self.upright else (columns, rows)
        index = AXES.index(self.axis)
        first[index] = np.tan(along) if self.projection == LATLON else along
        if self.projection == PINHOLE:
            second[1 - index], rows[2] = across, 1.0
        else:
            second[1 - index], second[2] = np.sin(across), np.cos(across)
        return columns, rows

    def parallax(self, shifted: Array, rows: "slice[int, int, None]") -> Float32Array:
        """Return focal length times baseline / distance, pixels, of d + doffs (N, W) of some rows, pixels.

        Both are the same but for latlon, where ρ = b / (tan λ_L - tan λ_R) = b cos λ_L cos λ_R / sin(λ_L - λ_R); where
        λ_R would lie beyond the baseline's end it is negative.
        """
        if self.projection != LATLON:
            return shifted
        left, between = self._latitude(shifted.shape[1], rows), shifted / np.float32(self.focal)
        return np.asarray(np.float32(self.focal) * np.sin(between) / (np.cos(left) * np.cos(left - between)))

    def effective(self, shifted: Array, rows: "slice[int, int, None]") -> Float32Array:
        """Return what a change of d + doffs (N, W) is divided by to give the relative change of the distance, pixels.

        That is d + doffs itself, for latlon the parallax divided by its derivative, f sin(λ_L - λ_R) cos λ_R / cos λ_L.
        """
        if self.projection != LATLON:
            return shifted
        left, between = self._latitude(shifted.shape[1], rows), shifted / np.float32(self.focal)
        return np.asarray(np.float32(self.focal) * np.sin(between) * np.cos(left - between) / np.cos(left))

    def _latitude(self, width: int, rows: slice) -> Array:
        """Return λ of the left camera's pixels in some rows, radians, (1, W) or (N, 1)."""
        if self.upright:
            return ((np.arange(rows.start, rows.stop)[:, None] - self.cy) / self.fy).astype(np.float32)
        return ((np.arange(width)[None] - self.cx) / self.fx).astype(np.float32)


def pinhole_intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy, pixels, of a camera without distortion; raises InvalidInput if it has any."""
    if not camera.model.is_pinhole(camera.parameters):
        raise InvalidInput(f"the camera is distorted ({camera.model.name}); undistort or rectify the images first")
    fx, fy, cx, cy = camera.parameters[:4].tolist()
    return fx, fy, cx, cy


def of_rectification(rectification: Rectification) -> StereoGeometry:
    """Return the geometry of a rectified pair."""
    focal, baseline = rectification.focal, rectification.baseline
    view = rectification.projection, rectification.axis
    return StereoGeometry(focal, focal, *rectification.left_centre, baseline, rectification.doffs, *view)


def of_pair(left: Camera, right: Camera, right_T_left: Pose) -> StereoGeometry:
    """Return the geometry of two rectified cameras; left and right are above each other where the baseline says so.

    Raises InvalidInput unless both are free of distortion or drawn about the baseline as axis, see along parallel axes,
    stand beside or above each other and share focal lengths and rows (or columns).
    """
    reason = why_not_rectified(left, right, right_T_left)
    if reason is not None:
        raise InvalidInput(reason)
    axis = _along(right_T_left)
    step = float(right_T_left.translation[axis])
    if step >= 0:
        where = "above the upper one" if axis else "left of the left one"
        raise InvalidInput(f"the {'lower' if axis else 'right'} camera is {where}: exchange the cameras")
    fx, fy, cx, cy = left.parameters[:4].tolist()
    doffs = float(right.parameters[2 + axis] - left.parameters[2 + axis])
    projection = _VIEWS[left.model.name][0] if left.model.name in _VIEWS else PINHOLE
    return StereoGeometry(fx, fy, cx, cy, -step, doffs, projection, AXES[axis])


def why_not_rectified(left: Camera, right: Camera, right_T_left: Pose) -> str | None:
    """Return why two cameras, in either order, are no rectified pair, None if they are one."""
    axis = _along(right_T_left)
    for camera in (left, right):
        view = _VIEWS.get(camera.model.name)
        if view is None and not camera.model.is_pinhole(camera.parameters):
            return f"the camera is distorted ({camera.model.name}); undistort or rectify the images first"
        if camera.model.name != left.model.name and view != _VIEWS.get(left.model.name):
            return f"the pair is not rectified: one camera is {left.model.name}, the other {camera.model.name}"
        if view is not None and view[1] != AXES[axis]:
            return f"the pair is not rectified: {camera.model.name} cameras whose baseline is along {AXES[axis]}"
    translation = right_T_left.translation
    angle = float(np.linalg.norm(so3.log(right_T_left.rotation)))
    if angle > _ANGLE or np.abs(np.delete(translation, axis)).max() > _ANGLE * abs(translation[axis]):
        x, y, z = translation.tolist()
        return f"the pair is not rectified: its axes differ by {angle:.2g} rad, t = ({x:g}, {y:g}, {z:g}) m"
    differences = np.abs(np.delete(right.parameters[:4] - left.parameters[:4], 2 + axis)).max()
    if differences > _PIXELS:
        across = "cx" if axis else "cy"
        return f"the pair is not rectified: fx, fy or {across} differ by {differences:.3g} px"
    return None


def _along(right_T_left: Pose) -> int:
    """Return 0 for a baseline that is rather along x than along y, 1 otherwise."""
    x, y, _ = np.abs(right_T_left.translation)
    return int(y > x)


class Confidence(IntEnum):
    """Where the disparity of a pixel comes from, the surest last; the numbers stand in files."""

    NONE = 0
    FILLED = 1  # from the neighbours: no matcher passed the left-right check
    SINGLE = 2  # one matcher passed it
    APART = 3  # both did, more than 1 px apart
    NEAR = 4  # 0.25 to 1 px apart
    AGREED = 5  # within 0.25 px


@dataclass(frozen=True, eq=False)
class Disparity(Brief):
    """Disparity of the left image, column in the left minus column in the right image.

    values: (H, W) float32 pixels, NaN where there is none. sigma: (H, W) float32 pixels, half the width of what holds
    68 % of the errors, NaN where there is no value. confidence: (H, W) uint8, see `Confidence`. searched: smallest and
    largest disparity looked for, pixels. at_ends: shares of the matches that lie at the lower and at the upper
    end of it.
    """

    values: Float32Array
    sigma: Float32Array
    confidence: NDArray[np.uint8]
    searched: tuple[int, int]
    at_ends: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        object.__setattr__(self, "values", readonly(self.values, (None, None), "values", np.float32))
        object.__setattr__(self, "sigma", readonly(self.sigma, shape, "sigma", np.float32))
        object.__setattr__(self, "confidence", readonly(self.confidence, shape, "confidence", np.uint8))


class Limits(NamedTuple):
    """What a pair and its map must keep to.

    rows_px: largest amount that rows may be off, pixels; a plane over the image puts so much right. matched: least
    share of the pixels that are matched and not filled. wrong_side: largest share of the features that may stand on the
    wrong side of what is infinitely far, from `sideways_px` pixels on. alike: largest share of the features that may be
    at one place in both images, to `parallax_px` pixels; two real images scatter more, whatever their distance.
    """

    rows_px: float = 5.0
    matched: float = 0.15
    wrong_side: float = 0.95
    sideways_px: float = 0.5
    alike: float = 0.95
    parallax_px: float = 0.25


LIMITS = Limits()


def too_few(matched: float, *, by_rig: bool = False) -> tuple[Message, ...]:
    """Return the failure of a map with such a share of matched pixels, none if they are enough.

    by_rig: the images were rectified by a rig file, so that this and their order may be wrong.
    """
    if matched >= LIMITS.matched:
        return ()
    text = (
        f"{100 * matched:.1f} % of the pixels matched (limit {100 * LIMITS.matched:g} %): check that both images show "
    )
    if by_rig:
        text += "the same scene, that LEFT and RIGHT are not exchanged, that the rig file is theirs, and the --range"
    else:
        text += "the same scene and are rectified, and the --range"
    return (Message("few_matches", text, {"matched": matched, "limit": LIMITS.matched}),)
