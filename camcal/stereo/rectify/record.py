"""A rectified pair: two cameras with parallel axes that stand beside or above each other, and how they are turned.

With λ the angle off the plane across the baseline, φ the angle about it from the optical axis of the pair, and
ρ = √(Y² + Z²) the distance of a point (X, Y, Z) from the line of the baseline, for cameras beside each other:

- pinhole      u = f X / Z + cx, v = f Y / Z + cy, disparity d = f b / Z
- cylindrical  u = f X / ρ + cx = f tan λ + cx, v = f φ + cy, disparity d = f b / ρ
- latlon       u = f λ + cx, v = f φ + cy, with b / ρ = tan λ_left − tan λ_right

For cameras above each other X and Y, and u and v, are exchanged: corresponding points are in one column of upright
images, and latlon is the equirectangular projection.

The images are drawn with the lenses and the transform as they were estimated. If these are off, the rectified images
are those of slightly other cameras: to first order, of the nearest ones with other fx fy cx cy, and another transform.
So the covariance of a calibration is carried to the parameters of the rectified cameras.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.cameras.catalogue import model_named
from camcal.cameras.lens import Projection, Rays
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.records import Brief

PINHOLE, CYLINDRICAL, LATLON = "pinhole", "cylindrical", "latlon"
PROJECTIONS = (PINHOLE, CYLINDRICAL, LATLON)
AXES = ("x", "y")
MODELS: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        (PINHOLE, "x"): "pinhole",
        (PINHOLE, "y"): "pinhole",
        (CYLINDRICAL, "x"): "cylinder_x",
        (CYLINDRICAL, "y"): "cylinder",
        (LATLON, "x"): "latlon_x",
        (LATLON, "y"): "equirectangular",
    }
)  # lens model of the rectified cameras by projection and axis
_COLUMNS, _ROWS = 16, 12  # places over the image that the nearest camera is fitted at


@dataclass(frozen=True, eq=False)
class OpenCVRectification:
    """What cv2.stereoRectify returns: R1, R2 (3, 3), P1, P2 (3, 4) with metres in the last column, Q (4, 4)."""

    R1: FloatArray
    R2: FloatArray
    P1: FloatArray
    P2: FloatArray
    Q: FloatArray


@dataclass(frozen=True, eq=False)
class Rectification(Brief):
    """How the images of two cameras are rectified.

    projection: pinhole, cylindrical or latlon. axis: "x", corresponding points are in one row, or "y", in one column.
    left, right: names of the cameras, of axis y the upper and the lower one, in the order that makes disparities
    positive; swapped: they were given the other way round. rect_R_left, rect_R_right: (3, 3), from the axes of either
    camera to those of the pair. size: (width, height) of both rectified images. focal: px, or px per radian.
    left_centre, right_centre: (cx, cy) px; they differ along the axis only. baseline: m, positive.
    kept: share of the common field of view, as a solid angle, that the rectified images hold.
    """

    projection: str
    axis: str
    left: str
    right: str
    rect_R_left: FloatArray
    rect_R_right: FloatArray
    size: tuple[int, int]
    focal: float
    left_centre: tuple[float, float]
    right_centre: tuple[float, float]
    baseline: float
    swapped: bool = False
    kept: float = 1.0
    warnings: tuple[Message, ...] = ()

    def __post_init__(self) -> None:
        for name in ("rect_R_left", "rect_R_right"):
            object.__setattr__(self, name, readonly(getattr(self, name), (3, 3), name))
        if (self.projection, self.axis) not in MODELS:
            raise InvalidInput(f"no projection {self.projection!r} about axis {self.axis!r}")
        if not (self.focal > 0 and self.baseline > 0 and min(self.size) > 0):
            raise InvalidInput(f"focal length {self.focal:g} px and baseline {self.baseline:g} m must be positive")
        across = self.left_centre[1 - self.along], self.right_centre[1 - self.along]
        if across[0] != across[1]:
            raise InvalidInput(f"the centres differ across the axis: {across[0]:g} and {across[1]:g} px")

    @property
    def along(self) -> int:
        """The coordinate along the baseline, of pixels and of points: 0 for axis x, 1 for axis y."""
        return AXES.index(self.axis)

    @property
    def doffs(self) -> float:
        """The right centre minus the left one along the axis, px: of a pinhole Z = focal baseline / (d + doffs)."""
        return self.right_centre[self.along] - self.left_centre[self.along]

    @property
    def left_camera(self) -> Camera:
        """The camera of the rectified left images."""
        return self._camera(self.left_centre)

    @property
    def right_camera(self) -> Camera:
        """The camera of the rectified right images."""
        return self._camera(self.right_centre)

    @property
    def right_T_left(self) -> Pose:  # noqa: N802 - the name of the transform
        """The pose of the rectified left camera in the rectified right one, m: a translation along the axis."""
        translation = np.zeros(3)
        translation[self.along] = -self.baseline
        return Pose(np.eye(3), translation)

    def pixels(self, points: Array) -> tuple[Projection, Projection]:
        """Return the pixels of points (N, 3), in the frame of the rectified left camera, m, in both images."""
        return self.left_camera.project(points), self.right_camera.project(self.right_T_left.apply(points))

    def rays(self, left: Array, right: Array) -> tuple[Rays, Rays]:
        """Return the unit rays of pixels (N, 2) of the left and (M, 2) of the right image, each in its rectified frame.

        Both frames have the same axes; `rect_R_left.T @ ray` is the ray in the frame of the left camera itself.
        """
        return self.left_camera.unproject(left), self.right_camera.unproject(right)

    def opencv(self) -> OpenCVRectification | None:
        """Return R1 R2 P1 P2 Q as cv2.stereoRectify does; None unless the projection is pinhole.

        Q takes (u, v, d, 1), d the disparity along the axis, to a homogeneous point in the frame of the rectified left
        camera.
        """
        if self.projection != PINHOLE:
            return None
        first, second = (np.column_stack([camera.K, np.zeros(3)]) for camera in (self.left_camera, self.right_camera))
        second[self.along, 3] = -self.focal * self.baseline
        (cx, cy), inverse = self.left_centre, 1 / self.baseline
        depth = np.array([(1, 0, 0, -cx), (0, 1, 0, -cy), (0, 0, 0, self.focal), (0, 0, inverse, self.doffs * inverse)])
        return OpenCVRectification(np.array(self.rect_R_left), np.array(self.rect_R_right), first, second, depth)

    def _camera(self, centre: tuple[float, float]) -> Camera:
        model = model_named(MODELS[self.projection, self.axis])
        return Camera(model, self.size, np.array([self.focal, self.focal, *centre]))


def rectified_covariance(
    rectification: Rectification, left: Camera, right: Camera, covariance: Array
) -> FloatArray | None:
    """Return the covariance (14, 14) of fx fy cx cy of the rectified left and right camera and of their right_T_left.

    left, right: the cameras that were rectified. covariance: (N, N) of the parameters of their lenses and of the step
    of right_T_left (order tx ty tz rx ry rz, m and rad; see Pose.retract). None where no lens is known over its image.
    """
    found = rectification
    first, second = len(left.parameters), len(right.parameters)
    jacobian = np.zeros((14, first + second + 6))
    lenses = (
        (left, found.left_camera, found.rect_R_left, slice(0, 4), slice(0, first)),
        (right, found.right_camera, found.rect_R_right, slice(4, 8), slice(first, first + second)),
    )
    for source, view, turn, rows, columns in lenses:
        by_lens = _view_by_lens(source, view, turn)
        if by_lens is None:
            return None
        jacobian[rows, columns] = by_lens
    # with A and B the rotations to rectified axes: A Exp(r) R Bᵀ = Exp(A r) A R Bᵀ, and A (t + s) = A t + A s
    jacobian[8:11, -6:-3] = jacobian[11:, -3:] = found.rect_R_right
    return np.asarray(jacobian @ covariance @ jacobian.T)


def _view_by_lens(source: Camera, view: Camera, view_R_source: Array) -> Array | None:
    """Return the derivatives (4, K) of the parameters of a view by those of the lens it is drawn with."""
    width, height = view.image_size
    grid = np.meshgrid(np.linspace(0, width - 1, _COLUMNS), np.linspace(0, height - 1, _ROWS))
    rays = view.unproject(np.column_stack([axis.ravel() for axis in grid])).directions
    taken = source.model.project_with_jacobians(source.parameters, rays @ view_R_source)
    last = np.array(source.image_size) - 1
    with np.errstate(invalid="ignore"):
        seen = taken.valid & np.all((taken.pixels >= 0) & (taken.pixels <= last), axis=1)
    if seen.sum() < 4:
        return None
    by_lens = taken.by_parameters(len(source.parameters))
    # the ray of a fixed pixel of the source, and where it stands in the view
    ray_by_lens = -np.linalg.pinv(taken.d_point[seen]) @ by_lens[seen]
    drawn = view.model.project_with_jacobians(view.parameters, rays[seen])
    moved = drawn.d_point @ view_R_source @ ray_by_lens
    by_view = drawn.d_parameters.reshape(-1, 4)
    return np.asarray(-np.linalg.lstsq(by_view, moved.reshape(len(by_view), -1), rcond=None)[0])
