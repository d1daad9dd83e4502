"""How large a pixel is: the angle it sees, and its size on a plane in front of the camera, through the lens's rays."""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.image_circle import ImageCircle
from camcal.cameras.model import Camera

_HALF = 0.25  # px to either side of a pixel's centre: derivatives to 1e-6, and corners stay inside the image


def pixel_angles(camera: Camera, pixels: Array) -> Array:
    """Return the angles (N,) in radians that pixels (N, 2) see: the roots of their solid angles; NaN without a ray."""
    right, down = _derivatives(camera.unproject(_around(pixels)).directions)
    return np.asarray(np.sqrt(np.linalg.norm(np.cross(right, down), axis=1)))


def pixel_sizes(camera: Camera, pixels: Array, distance: float) -> Array:
    """Return the sizes (N,) in metres of pixels (N, 2) on a plane across the axis: the roots of their areas.

    NaN where a pixel has no ray or looks away from the plane.
    """
    right, down = _derivatives(_on_plane(camera.unproject(_around(pixels)).directions, distance))
    return np.asarray(np.sqrt(np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])))


def field_size(camera: Camera, distance: float, circle: ImageCircle | None = None) -> tuple[float, float]:
    """Return width and height (m) of what the middle row and column of the image see at a distance along the axis.

    To the outer edges of the pixels, or to the image circle where it ends before them; NaN where there is no ray or the
    field reaches 180°.
    """
    width, height = camera.image_size
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    ends = np.array([[-0.5, middle_y], [width - 0.5, middle_y], [middle_x, -0.5], [middle_x, height - 0.5]])
    ends = ends if circle is None else circle.clipped(np.array([middle_x, middle_y]), ends)
    left, right, top, bottom = _on_plane(camera.unproject(ends).directions, distance)
    return float(np.linalg.norm(right - left)), float(np.linalg.norm(bottom - top))


def _around(pixels: Array) -> Array:
    """Return places right, left, below and above every pixel, (4 N, 2)."""
    steps = _HALF * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    return np.asarray((steps[:, None] + np.asarray(pixels, dtype=float)).reshape(-1, 2))


def _derivatives(values: Array) -> tuple[Array, Array]:
    """Return the derivatives (N, D) by u and v of values (4 N, D) at the places of `_around`."""
    right, left, below, above = values.reshape(4, -1, values.shape[1])
    return (right - left) / (2 * _HALF), (below - above) / (2 * _HALF)


def _on_plane(rays: Array, distance: float) -> Array:
    """Return where rays (N, 3) meet the plane at a distance along the axis, (N, 2); NaN for those that do not."""
    forward = np.where(rays[:, 2] > 0, rays[:, 2], np.nan)
    return np.asarray(distance * rays[:, :2] / forward[:, None])
