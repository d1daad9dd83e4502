"""The picture of a rig: cameras as frusta, boards as outlines, made of points that the viewer of clouds shows."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera, Rig
from camcal.cameras.validity import ImageCircle
from camcal.geometry.pose import Pose
from camcal.report.cloud_scene import CloudScene
from camcal.report.frusta import board_outline, frustum, frustum_length
from camcal.targets.board import Board

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
        parts += [(rig.rig_T_camera[name].apply(line), colour) for line in _frustum(camera, circles.get(name), length)]
    places = [pose.translation for pose in rig.rig_T_camera.values()]
    parts += [(np.array([places[0], place]), _ORIGIN) for place in places[1:]]
    if board is not None and board.unit == "m":
        outline = board_outline(board)[[0, 1, 2, 3, 0]]
        parts += [(pose.apply(outline), _BOARD) for pose in boards]
    extent = np.ptp(np.concatenate([line for line, _ in parts]), axis=0).max()
    step = max(extent / _SAMPLES, _total(parts) / _MOST)
    dense = [_dense(line, step) for line, _ in parts]
    points = np.concatenate(dense)
    shades = np.concatenate(
        [np.tile(np.array(colour, np.uint8), (len(line), 1)) for line, (_, colour) in zip(dense, parts, strict=True)]
    )
    return CloudScene(points.astype(np.float32), shades, None, "m", f"rig: {FRAME}", len(points))


def colour_name(index: int) -> str:
    """Return the name of the colour of a camera, by its place among them."""
    return list(COLOURS)[index % len(COLOURS)]


def _frustum(camera: Camera, circle: ImageCircle | None, length: float) -> list[Array]:
    """Return the lines (N, 3) of a camera's frustum and of its optical axis."""
    return [*frustum(camera, length, _BORDER, circle), np.array([(0.0, 0.0, 0.0), (0.0, 0.0, _AXIS * length)])]


def _total(parts: Sequence[tuple[Array, tuple[int, int, int]]]) -> float:
    return float(sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line, _ in parts))


def _dense(line: Array, step: float) -> Array:
    """Return points (M, 3) along a line (N, 3), no farther apart than a step."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if lengths[-1] == 0:
        return line[:1]
    along = np.linspace(0, lengths[-1], max(2, int(np.ceil(lengths[-1] / step)) + 1))
    return np.column_stack([np.interp(along, lengths, column) for column in line.T])
