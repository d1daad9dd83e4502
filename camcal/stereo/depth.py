"""Depth of the disparities of a rectified pair with its uncertainty, and the frames that points are written in.

Maps have tens of megapixels; everything here works on a slice of rows, so that what stands between the map and its
points stays in the cache.
"""

from collections.abc import Iterable, Iterator
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.geometry.pose import CONVENTIONS, Pose, change
from camcal.records import Brief
from camcal.stereo.depth_error import CalibrationError
from camcal.stereo.disparity import StereoGeometry
from camcal.stereo.rectify.record import LATLON

_FARTHEST = 1e38  # metres; hardly more fits into a float32


@dataclass(frozen=True, eq=False)
class StereoImage(Brief):
    """The left image of a rectified pair and what is known of its pixels. The arrays are neither copied nor changed.

    disparity: (H, W) pixels, left minus right; NaN and infinite values mean no match, zero and less as well unless
    signed: then the search went below zero, as for cameras that are toed in, and d + doffs > 0 alone decides.
    pixels: (H, W) gray, (H, W, 3) blue, green, red or (H, W, 4) with alpha; uint8, uint16 or float32 0 … 1.
    sigma: (H, W) or one number, pixels, standard deviation of the disparity, NaN where it is not known.
    confidence: (H, W), see `Confidence`. calibration: what its uncertainty adds, None for an exact one.
    Raises InvalidInput if a picture has another size than the map.
    """

    disparity: Float32Array
    geometry: StereoGeometry
    signed: bool = False
    pixels: PixelArray | None = None
    sigma: Float32Array | float | None = None
    confidence: NDArray[np.uint8] | None = None
    calibration: CalibrationError | None = None

    def __post_init__(self) -> None:
        require_size(self.pixels, self.shape, "image")
        require_size(self.sigma if isinstance(self.sigma, np.ndarray) else None, self.shape, "image of sigma")
        require_size(self.confidence, self.shape, "image of confidence")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        height, width = self.disparity.shape
        return height, width

    def matched(self, rows: slice) -> BoolArray:
        """Return where in some rows there is a match before the cameras, (N, W) bool."""
        return self._matched(rows, self._shifted_as_is(rows))

    def shifted(self, rows: slice) -> Float32Array:
        """Return d + doffs of some rows (N, W), float32 pixels, NaN where there is no match before the cameras."""
        shifted = self._shifted_as_is(rows)
        return np.where(self._matched(rows, shifted), shifted, np.float32(np.nan))

    def parallax(self, rows: slice) -> Float32Array:
        """Return f b / depth of some rows (N, W), float32 pixels, NaN where there is no match before the cameras."""
        return self.geometry.parallax(self.shifted(rows), rows)

    def depth(self, rows: slice) -> Float32Array:
        """Return the depth of some rows (N, W), float32 metres, NaN where there is no match.

        z along the optical axis, f b / (d + doffs): Hartley & Zisserman, 2nd ed., ch. 9; where the geometry is not
        pinhole, the distance from the baseline's line.
        """
        return np.asarray(np.float32(self.geometry.scale) / self.parallax(rows))

    def depth_of_matches(self, rows: slice) -> Float32Array:
        """Return the same as `depth`, but any number where there is no match: for who knows where that is."""
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            return np.asarray(np.float32(self.geometry.scale) / self.geometry.parallax(self._shifted_as_is(rows), rows))

    def _shifted_as_is(self, rows: slice) -> Array:
        disparity = self.disparity[rows].astype(np.float32, copy=False)
        return np.asarray(disparity + np.float32(self.geometry.doffs))

    def _matched(self, rows: slice, shifted: Array) -> Array:
        least = np.float32(self.geometry.scale / _FARTHEST)
        matched = (shifted > least) & (shifted < np.inf)
        if self.geometry.projection == LATLON:
            with np.errstate(invalid="ignore", over="ignore"):
                matched &= self.geometry.parallax(shifted, rows) > least
        if self.geometry.doffs > 0 and not self.signed:
            matched &= self.disparity[rows] > 0
        return np.asarray(matched)

    def relative_sigma(self, rows: slice) -> Float32Array:
        """Return the standard deviation of the depth of some rows as a share of it, (N, W), NaN where not known.

        (sigma_z / z)² = (sigma_d² + what the calibration adds) / (d + doffs)²; for latlon see StereoGeometry.effective.
        Raises InvalidInput if sigma is not known at all.
        """
        if self.sigma is None:
            raise InvalidInput("unknown standard deviation of the disparity: set --sigma-disparity")
        sigma = np.asarray(self.sigma[rows] if isinstance(self.sigma, np.ndarray) else self.sigma, np.float32)
        effective = self.geometry.effective(self.shifted(rows), rows)
        with np.errstate(over="ignore"):
            if self.calibration is None:
                return np.asarray(sigma / effective)
            return np.asarray(np.sqrt(sigma**2 + self.calibration.variance_of(effective, rows)) / effective)


def row_blocks(shape: tuple[int, int], pixels: int) -> Iterator[slice]:
    """Yield slices of rows that together are all rows of an image (height, width), each of about so many pixels."""
    height, width = shape
    step = max(1, pixels // width)
    return (slice(start, min(start + step, height)) for start in range(0, height, step))


def widened(rows: slice, halo: int, height: int) -> tuple[slice, slice]:
    """Return rows with up to `halo` more on either side, and where in those the rows themselves are."""
    start, stop = max(rows.start - halo, 0), min(rows.stop + halo, height)
    return slice(start, stop), slice(rows.start - start, rows.stop - start)


def require_size(image: Array | None, shape: tuple[int, int], name: str) -> None:
    """Raise InvalidInput if there is an image and it has another size than the disparity map (height, width)."""
    if image is not None and image.shape[:2] != shape:
        height, width = image.shape[:2]
        raise InvalidInput(
            f"the {name} is {width} × {height}, the disparity map {shape[1]} × {shape[0]}; they must be the same"
        )


POSITION = ("x", "y", "z")
COLOUR = ("red", "green", "blue")
NORMAL = ("nx", "ny", "nz")
INTENSITY = "intensity"
SIGMA = "sigma"

METRES = "m"
LEFT_CAMERA = "left camera: x right, y down, z forward"
OPTICAL = "optical"
CAMERA = "camera"
ROS = "ros"
OPENGL = "opengl"
ENU = "enu"
UNITS = MappingProxyType({METRES: 1.0, "mm": 1000.0})
_TURNS = {name: change(CONVENTIONS["opencv"], CONVENTIONS[name]) for name in (ROS, OPENGL)}
WORDS = MappingProxyType(
    {
        OPTICAL: LEFT_CAMERA,
        CAMERA: "left camera before rectification: x right, y down, z forward",
        ROS: "left camera: x forward, y left, z up",
        OPENGL: "left camera: x right, y up, z backward",
        ENU: "world: x east, y north, z up",
    }
)
FRAMES = tuple(WORDS)


def vertex_type(
    *, colour: bool = False, intensity: bool = False, normals: bool = False, sigma: bool = False
) -> np.dtype[np.void]:
    """Return the record of one vertex: x y z, then what else it has, in the order in which files hold it.

    x y z: float32. red green blue: uint8. intensity: float32, 0 … 1. nx ny nz: float32, of length 1. sigma: float32,
    standard deviation of the depth, in the unit of x y z.
    """
    fields = [(name, "<f4") for name in POSITION]
    if colour:
        fields += [(name, "u1") for name in COLOUR]
    if intensity:
        fields.append((INTENSITY, "<f4"))
    if normals:
        fields += [(name, "<f4") for name in NORMAL]
    if sigma:
        fields.append((SIGMA, "<f4"))
    return np.dtype(fields)


@dataclass(frozen=True, eq=False)
class VertexStream:
    """A point cloud on its way to a file.

    count: number of vertices, known before the first. type: their record, see `vertex_type`. blocks: structured arrays
    (N,) of that type which together hold `count`; can be gone through once. unit: m or mm. frame: in words. notes:
    more that files with room for comments carry, such as fx and the baseline. grid: (width, height) if the vertices
    are the pixels of an image, row by row, with NaN where there is no point; None otherwise.
    """

    count: int
    type: np.dtype[np.void]
    blocks: Iterable[NDArray[np.void]]
    unit: str = METRES
    frame: str = LEFT_CAMERA
    notes: dict[str, str] = field(default_factory=dict)
    grid: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame in words, and the pose that takes points of the rectified left camera (x right, y down, z forward) there.

    unit: of the coordinates, m or mm.
    """

    frame_T_left: Pose = field(default_factory=Pose.identity)
    words: str = LEFT_CAMERA
    unit: str = METRES


def frame_named(
    name: str, camera_R_rectified: Array | None = None, world_T_camera: Pose | None = None, unit: str = METRES
) -> Frame:
    """Return the frame of a name, or with a pose the world of that pose.

    The pose takes points from the frame named to the world: with ros, that of a camera whose x looks forward. With enu
    it takes them from the camera's frame, the optical one where no rotation is known. camera_R_rectified: (3, 3), for
    the frame `camera`.
    Raises InvalidInput for an unknown name or unit, and where a frame needs what is not given.
    """
    if name not in WORDS:
        raise InvalidInput(f"frame {name!r} is unknown; use one of {', '.join(FRAMES)}")
    if unit not in UNITS:
        raise InvalidInput(f"unit {unit!r} is unknown; use one of {', '.join(UNITS)}")
    if name == ENU and world_T_camera is None:
        raise InvalidInput("--frame enu needs the pose of the camera in the world: set --pose")
    if name == CAMERA and camera_R_rectified is None:
        raise InvalidInput("--frame camera needs the rectification of the pair, which no sidecar of the map has")
    turns = _TURNS if camera_R_rectified is None else {**_TURNS, CAMERA: camera_R_rectified, ENU: camera_R_rectified}
    named_T_left = Pose(turns.get(name, np.eye(3)), np.zeros(3))
    if world_T_camera is None:
        return Frame(named_T_left, WORDS[name], unit)
    return Frame(world_T_camera @ named_T_left, WORDS[ENU] if name == ENU else "world of the pose given", unit)


class BackProjection:
    """Pixels and their depths as points in a frame: the depth times `StereoGeometry.rays`, then the frame's pose."""

    def __init__(self, geometry: StereoGeometry, shape: tuple[int, int], frame: Frame) -> None:
        """Prepare for images of a shape (height, width)."""
        scale = UNITS[frame.unit]
        rotation = frame.frame_T_left.rotation
        columns, rows = geometry.rays(shape)
        self._rotation = rotation.astype(np.float32)
        self._offset = (scale * frame.frame_T_left.translation).astype(np.float32)
        # A ray at depth 1 is what its column says plus what its row says.
        self._across = (scale * (rotation @ columns)).astype(np.float32)
        self._down = (scale * (rotation @ rows)).astype(np.float32)[..., None]

    def coordinate(self, axis: int, rows: slice, depth: Array) -> Array:
        """Return coordinate 0, 1 or 2 of the points of some rows with depths (N, W), metres; in the frame's unit."""
        across, down = self._across[axis], self._down[axis][rows]
        ray = across if not down.any() else down if not across.any() else across + down
        values = ray * depth
        if self._offset[axis]:
            values += self._offset[axis]
        return np.asarray(values)

    def points(self, rows: slice, depth: Array) -> Array:
        """Return the points (N, W, 3) of some rows with depths (N, W), metres; in the frame's unit."""
        return np.stack([self.coordinate(axis, rows, depth) for axis in range(3)], axis=-1)

    def turned(self, directions: Array) -> Array:
        """Return directions of the rectified left camera, their components (3, N, W), in the frame."""
        return np.tensordot(self._rotation, directions, axes=1)
