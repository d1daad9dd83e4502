"""Lines of cameras and boards in space, for pictures of calibrations."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, rim
from camcal.geometry.pose import Pose
from camcal.targets.board import Board

_OF_NEAREST = 0.4  # of the distance to the nearest camera
_OF_BOARDS = 0.15  # of the distance of the boards
_ALONE = 0.1  # m, of a camera without others and without boards


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
