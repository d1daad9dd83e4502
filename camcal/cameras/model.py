"""A camera: lens model, image size and parameters; a rig of cameras."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from camcal.arrays import Array, FloatArray, readonly, require_shape
from camcal.cameras.catalogue import MODELS
from camcal.cameras.directions import projection_covariances
from camcal.cameras.lens import FISHEYE, OPENCV, CameraModel, Projection, ProjectionJacobians, Rays
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.records import Brief
from camcal.solve.differentiate import central_jacobian


@dataclass(frozen=True, eq=False)
class Camera(Brief):
    """A model with its parameters (K,), an image size (width, height) and, if known, the (K, K) covariance.

    fixed: names of parameters that were held in the solve; their rows of the covariance are zero.
    """

    model: CameraModel
    image_size: tuple[int, int]
    parameters: FloatArray
    covariance: FloatArray | None = None
    fixed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.model.parameter_names)
        object.__setattr__(self, "parameters", readonly(self.parameters, (count,), "parameters"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (count, count), "covariance"))
        unknown = set(self.fixed) - set(self.model.parameter_names)
        if unknown:
            raise InvalidInput(f"{self.model.name} has no parameter {min(unknown)!r}")

    def __repr__(self) -> str:
        """Return the lens model, the size and the parameters."""
        values = ", ".join(f"{name}={self.value(name):.7g}" for name in self.listed)
        return f"Camera({self.model.name}, {self.image_size[0]}x{self.image_size[1]} px, {values})"

    @property
    def listed(self) -> tuple[str, ...]:
        """The names of the parameters that mean something by themselves: not those of the knots of a spline."""
        return self.model.parameter_names[:4] if self.model.configuration else self.model.parameter_names

    @classmethod
    def from_opencv(
        cls, K: ArrayLike, dist: ArrayLike | None, size: tuple[int, int], *, fisheye: bool = False
    ) -> "Camera":
        """Return the camera of OpenCV's camera matrix K (3, 3), pixels, and distortion coefficients.

        dist: as many coefficients as OpenCV takes (0, 4, 5, 8, 12 or 14; of cv2.fisheye 4), None for none. size: width
        and height of the images. Raises InvalidInput for a matrix with skew, or another number of coefficients.
        """
        matrix = require_shape(K, (3, 3), "the camera matrix")
        coefficients = np.zeros(0) if dist is None else np.asarray(dist, np.float64).ravel()
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        if not (np.isfinite(matrix).all() and fx > 0 and fy > 0):
            raise InvalidInput(f"a camera matrix has positive focal lengths, found fx = {fx:g}, fy = {fy:g}")
        if not np.array_equal(matrix, [(fx, 0, cx), (0, fy, cy), (0, 0, 1)]):
            raise InvalidInput("a camera matrix is (fx 0 cx, 0 fy cy, 0 0 1); skew is not supported")
        module = FISHEYE if fisheye else OPENCV
        known = {len(model.parameter_names) - 4: model for model in MODELS.values() if model.opencv == module}
        if len(coefficients) not in known:
            counts = ", ".join(map(str, sorted(known)))
            raise InvalidInput(f"{module} takes {counts} distortion coefficients, found {len(coefficients)}")
        return cls(known[len(coefficients)], size, np.concatenate([(fx, fy, cx, cy), coefficients]))

    @property
    def K(self) -> FloatArray:  # noqa: N802 - its name everywhere
        """The camera matrix (3, 3): fx 0 cx, 0 fy cy, 0 0 1, pixels."""
        fx, fy, cx, cy = self.parameters[:4].tolist()
        return np.array([(fx, 0.0, cx), (0.0, fy, cy), (0.0, 0.0, 1.0)])

    @property
    def dist(self) -> FloatArray:
        """The distortion coefficients (N,) as OpenCV takes them; of cv2.fisheye for a fisheye lens.

        Raises InvalidInput for a lens model that OpenCV does not have.
        """
        if not self.model.opencv:
            raise InvalidInput(f"OpenCV has no lens model {self.model.name}: it has no distortion coefficients for it")
        return self.parameters[4:].copy()

    def project(self, points: ArrayLike) -> Projection:
        """Return the pixels of points (N, 3) in the camera frame."""
        return self.model.project(self.parameters, require_shape(points, (None, 3), "points"))

    def project_with_jacobians(self, points: ArrayLike) -> ProjectionJacobians:
        """Return the pixels of points (N, 3) in the camera frame, with their derivatives by points and parameters."""
        return self.model.project_with_jacobians(self.parameters, require_shape(points, (None, 3), "points"))

    def unproject(self, pixels: ArrayLike) -> Rays:
        """Return the unit rays of pixels (N, 2)."""
        return self.model.unproject(self.parameters, require_shape(pixels, (None, 2), "pixels"))

    def projection_std(self, pixels: ArrayLike) -> FloatArray:
        """Return the standard deviations (N,), px, of the projections of far points that are seen at pixels (N, 2), or
        of one at a pixel (2,): RMS over the image directions, after the rotation that suits the image best.

        NaN where the lens is not valid. Raises InvalidInput where the covariance is not known.
        """
        found = projection_covariances(self, np.atleast_2d(np.asarray(pixels, np.float64)))
        std = np.sqrt(np.trace(found, axis1=1, axis2=2) / 2)
        return np.asarray(std if np.ndim(pixels) > 1 else std[0])

    def focal_lengths(self) -> tuple[FloatArray, FloatArray]:
        """Return pixels per radian on the axis along x and y (2,) and their standard deviations (2,), 0 where unknown.

        They are fx and fy of most lenses; of a mirror or two spheres fx / (1 + ξ), known better than fx alone.
        """

        def ahead(parameters: Array) -> ProjectionJacobians:
            return self.model.project_with_jacobians(parameters, np.array([[0.0, 0.0, 1.0]]), within_domain=False)

        def lengths(values: Array, of: Array | slice = slice(None)) -> Array:
            parameters = self.parameters.copy()
            parameters[of] = values
            return np.asarray(ahead(parameters).d_point[0, (0, 1), (0, 1)])

        if self.covariance is None:
            return lengths(self.parameters), np.zeros(2)
        columns = ahead(self.parameters).columns
        of = np.arange(len(self.parameters)) if columns is None else columns[0]  # a spline has few knots on the axis
        slopes = central_jacobian(lambda values: lengths(values, of), self.parameters[of])
        variances = np.einsum("ai,ij,aj->a", slopes, self.covariance[np.ix_(of, of)], slopes)
        return lengths(self.parameters), np.sqrt(np.maximum(variances, 0.0))

    def value(self, name: str) -> float:
        """Return one parameter by its name, such as 'fx'."""
        return float(self.parameters[self.model.parameter_names.index(name)])

    def std(self, name: str) -> float | None:
        """Return the standard deviation of one parameter; None when the covariance is unknown or it was fixed."""
        if self.covariance is None or name in self.fixed:
            return None
        index = self.model.parameter_names.index(name)
        return float(np.sqrt(self.covariance[index, index]))


@dataclass(frozen=True, eq=False)
class Rig(Brief):
    """Cameras by name and where each stands: rig_T_camera takes points of a camera's frame to the rig's, metres.

    covariance: (N, N) of, camera by camera, its parameters and the step of camera_T_rig (order tx ty tz rx ry rz, m and
    rad); None where only the cameras' own covariances are known, and where they stand is taken as exact.
    """

    cameras: Mapping[str, Camera]
    rig_T_camera: Mapping[str, Pose]
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.covariance is not None:
            count = sum(len(camera.parameters) + 6 for camera in self.cameras.values())
            object.__setattr__(self, "covariance", readonly(self.covariance, (count, count), "covariance"))
        if not self.cameras:
            raise InvalidInput("a rig needs at least one camera")
        without = [name for name in self.cameras if name not in self.rig_T_camera]
        if without:
            raise InvalidInput(f"no transform connects camera {without[0]!r} to the rig")
        object.__setattr__(self, "cameras", MappingProxyType(dict(self.cameras)))
        object.__setattr__(self, "rig_T_camera", MappingProxyType(dict(self.rig_T_camera)))

    def rows(self, camera: str) -> "slice[int, int, None]":
        """Return where a camera's parameters, and then its pose, stand in the covariance."""
        names = list(self.cameras)
        before = names[: names.index(camera)]
        start = sum(len(self.cameras[name].parameters) + 6 for name in before)
        return slice(start, start + len(self.cameras[camera].parameters) + 6)

    def resized(self, sizes: Mapping[str, tuple[int, int]]) -> "Rig":
        """Return the rig with some cameras as they are for images resized to (width, height); raises as `resized`."""
        cameras = {name: resized(camera, sizes.get(name, camera.image_size)) for name, camera in self.cameras.items()}
        covariance = self.covariance
        if covariance is not None:
            jacobian = np.eye(len(covariance))
            for name, camera in self.cameras.items():
                rows = self.rows(name)
                lens = slice(rows.start, rows.stop - 6)
                jacobian[lens, lens] = reframing(camera, _scale(camera, cameras[name].image_size))[1]
            covariance = jacobian @ covariance @ jacobian.T
        return Rig(cameras, self.rig_T_camera, covariance)


def require_central(model: CameraModel, where: str | None = None) -> None:
    """Raise InvalidInput for a lens whose rays do not meet; where: the file that has it."""
    if not model.is_central:
        raise InvalidInput(
            f"the rays of the lens model {model.name} are parallel: its images do not say how far away a thing is, as "
            "is needed here; calibrate, inspect, plot and undistort take such a lens",
            where=where,
        )


def resized(camera: Camera, image_size: tuple[int, int]) -> Camera:
    """Return the camera of the same images resized to (width, height), its covariance carried along.

    Raises InvalidInput if the sizes differ in shape by more than rounding: such images were cropped.
    """
    if image_size == camera.image_size:
        return camera
    (width, height), (usual_width, usual_height) = image_size, camera.image_size
    if abs(width * usual_height - height * usual_width) > max(*image_size, *camera.image_size):
        raise InvalidInput(
            f"images of {width} x {height} pixels are not resized images of {usual_width} x {usual_height}: "
            "they need a camera of their own"
        )
    return reframed(camera, image_size, _scale(camera, image_size))


def reframed(
    camera: Camera, image_size: tuple[int, int], scale: tuple[float, float], offset: tuple[float, float] = (0.0, 0.0)
) -> Camera:
    """Return the camera of its images resized by `scale` (x, y), then cropped at `offset` (x, y) px to a size (width,
    height), its covariance carried along.
    """
    parameters, jacobian = reframing(camera, scale, offset)
    covariance = None if camera.covariance is None else jacobian @ camera.covariance @ jacobian.T
    return Camera(camera.model, image_size, parameters, covariance, camera.fixed)


def reframing(
    camera: Camera, scale: tuple[float, float], offset: tuple[float, float] = (0.0, 0.0)
) -> tuple[Array, Array]:
    """Return the parameters (K,) as in `reframed`, and their derivatives (K, K) by those of the camera."""
    parameters = camera.model.rescale(camera.parameters, scale, offset)
    # both are affine in the parameters: a step of 1 gives the exact derivative
    moved = [camera.model.rescale(camera.parameters + step, scale, offset) for step in np.eye(len(parameters))]
    return parameters, np.column_stack(moved) - parameters[:, None]


def _scale(camera: Camera, image_size: tuple[int, int]) -> tuple[float, float]:
    return image_size[0] / camera.image_size[0], image_size[1] / camera.image_size[1]
