"""The picture of a rig: cameras as frusta, boards as outlines, made of points that the viewer of clouds shows.

The lines of frusta and boards are those of the figures of calibrations too.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera, Rig
from camcal.cameras.validity import ImageCircle, rim
from camcal.geometry.pose import Pose
from camcal.report.cloud_scene import CloudScene
from camcal.targets.board import Board

_OF_NEAREST = 0.4  # of the distance to the nearest camera
_OF_BOARDS = 0.15  # of the distance of the boards
_ALONE = 0.1  # m, of a camera without others and without boards
FRAME = "x right, y down, z forward"
COLOURS = {  # of the cameras in their order
    "blue": (0, 114, 178),
    "orange": (230, 130, 0),
    "green": (0, 140, 100),
    "purple": (170, 80, 160),
    "red": (200, 60, 20),
    "light blue": (70, 160, 220),
}
_BOARD, _ORIGIN = (150, 150, 150), (90, 90, 90)
_SAMPLES = 1500  # points along the scene's extent: lines are that dense
_MOST = 400_000
_BORDER = 12  # rays of each edge of an image
_AXIS = 0.5  # of a frustum's length: the optical axis


def frustum(camera: Camera, length: float, per_edge: int, circle: ImageCircle | None = None) -> list[Array]:
    """Return the lines (N, 3) of a camera's frustum, in its frame: the border of its image, and four edges to it; none
    where the lens has no rays there.

    length: of the rays. per_edge: rays of each edge of the image. circle: the image circle, whose border is taken.
    """
    border = camera.unproject(rim(camera, per_edge, circle)[0]).directions
    border = length * border[np.isfinite(border).all(axis=1)]
    if not len(border):
        return []
    edges = border[:: max(len(border) // 4, 1)][:4]
    return [np.vstack([border, border[:1]]), *(np.stack([np.zeros(3), edge]) for edge in edges)]


def frustum_length(rig_T_camera: Sequence[Pose], rig_T_board: Sequence[Pose] = ()) -> float:
    """Return how long (m) the frusta of the cameras of a rig are drawn: apart, and visible beside the boards."""
    places = np.array([pose.translation for pose in rig_T_camera])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    nearest = [float(row[row > 0].min()) for row in apart if (row > 0).any()]
    far = [float(np.linalg.norm(pose.translation)) for pose in rig_T_board]
    return max(_OF_NEAREST * float(np.median(nearest or 0)), _OF_BOARDS * float(np.median(far or 0))) or _ALONE


def board_outline(board: Board) -> Array:
    """Return the corners (4, 3) of the rectangle around a board's points, in its frame and unit."""
    width, height = board.extent
    return np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])


def rig_scene(
    rig: Rig,
    boards: Sequence[Pose] = (),
    board: Board | None = None,
    circles: Mapping[str, ImageCircle] = MappingProxyType({}),
) -> CloudScene:
    """Return the cameras of a rig in their colours, and the boards that they saw, in the frame of the rig, metres.

    boards: rig_T_board. board: its size, without which none is drawn. circles: image circles of cameras by their names.
    """
    length = frustum_length(list(rig.rig_T_camera.values()), boards)
    parts: list[tuple[Array, tuple[int, int, int]]] = []
    colours = list(COLOURS.values())
    for index, (name, camera) in enumerate(rig.cameras.items()):
        colour = colours[index % len(colours)]
        lines = frustum(camera, length, _BORDER, circles.get(name))
        axis = np.array([(0.0, 0.0, 0.0), (0.0, 0.0, _AXIS * length)])
        parts += [(rig.rig_T_camera[name].apply(line), colour) for line in (*lines, axis)]
    places = [pose.translation for pose in rig.rig_T_camera.values()]
    parts += [(np.array([places[0], place]), _ORIGIN) for place in places[1:]]
    if board is not None and board.unit == "m":
        outline = board_outline(board)[[0, 1, 2, 3, 0]]
        parts += [(pose.apply(outline), _BOARD) for pose in boards]
    extent = np.ptp(np.concatenate([line for line, _ in parts]), axis=0).max()
    total = float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line, _ in parts))
    step = max(extent / _SAMPLES, total / _MOST)
    dense = [_dense(line, step) for line, _ in parts]
    points = np.concatenate(dense)
    shades = np.concatenate(
        [np.tile(np.array(colour, np.uint8), (len(line), 1)) for line, (_, colour) in zip(dense, parts, strict=True)]
    )
    return CloudScene(points.astype(np.float32), shades, None, "m", f"rig: {FRAME}", len(points))


def colour_name(index: int) -> str:
    """Return the name of the colour of a camera, by its place among them."""
    return list(COLOURS)[index % len(COLOURS)]


def _dense(line: Array, step: float) -> Array:
    """Return points (M, 3) along a line (N, 3), no farther apart than a step."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if lengths[-1] == 0:
        return line[:1]
    along = np.linspace(0, lengths[-1], max(2, int(np.ceil(lengths[-1] / step)) + 1))
    return np.column_stack([np.interp(along, lengths, column) for column in line.T])
