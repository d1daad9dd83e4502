"""Points of a cloud in a given frame, as packed vertex records in blocks."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.geometry.pose import CONVENTIONS, Pose, change
from camcal.stereo.geometry import StereoGeometry

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
