"""Lines of cameras and boards in space, for pictures of calibrations."""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, rim
from camcal.targets.board import Board


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


def board_outline(board: Board) -> Array:
    """Return the corners (4, 3) of the rectangle around a board's points, in its frame and unit."""
    width, height = board.extent
    return np.array([[0.0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]])
