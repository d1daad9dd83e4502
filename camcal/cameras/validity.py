"""Where a camera's model holds within its image: folds, field of view, and the region written to its file."""

import math
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.cameras.image_circle import ImageCircle
from camcal.cameras.model import Camera

PER_EDGE = 16  # samples of each edge of the image: a corner and those towards the next one
HALVINGS = 20  # of a segment across the image: to a millionth of it


@dataclass(frozen=True)
class Fold:
    """Whether the model stops being one-to-one inside the image, and where, both from the principal point.

    radius_px: the nearest place without a ray, inf if there is none. corner_px: the farthest corner of the image, or
    place of its image circle.
    """

    folds: bool
    radius_px: float
    corner_px: float


def folds_inside(camera: Camera, circle: ImageCircle | None = None) -> Fold:
    """Return where the model stops being one-to-one on the way from the principal point to the image's border, or to
    its image circle.
    """
    return rim(camera, circle=circle)[1]


def valid_block(camera: Camera, circle: ImageCircle | None = None) -> dict[str, float]:
    """Return max_theta_deg and max_radius_px: how far from the axis the model holds, as far as there is an image."""
    border, fold = rim(camera, circle=circle)
    rays = camera.unproject(border).directions
    theta = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return {
        "max_theta_deg": float(np.degrees(np.nanmax(theta))),
        "max_radius_px": min(fold.radius_px, fold.corner_px),
    }


def field_of_view(camera: Camera, circle: ImageCircle | None = None) -> tuple[float, float, float]:
    """Return the horizontal, vertical and diagonal field of view (rad), to the outer edges of the pixels.

    Horizontal and vertical are taken through the middle of the image, the diagonal is the larger of the two; to the
    image circle where it ends before the image. NaN where the model has no ray for an edge. Lenses beyond 180° are
    counted in full.
    """
    width, height = camera.image_size
    left, top, right, bottom = -0.5, -0.5, width - 0.5, height - 0.5
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    ends = np.array(
        [
            [[left, middle_y], [right, middle_y]],
            [[middle_x, top], [middle_x, bottom]],
            [[left, top], [right, bottom]],
            [[right, top], [left, bottom]],
        ]
    )
    edges = ends.reshape(-1, 2)
    edges = edges if circle is None else circle.clipped(np.array([middle_x, middle_y]), edges)
    rays = camera.unproject(edges).directions.reshape(4, 2, 3)
    horizontal, vertical, falling, rising = _openings(rays).tolist()
    return horizontal, vertical, float(np.maximum(falling, rising))


def _openings(rays: Array) -> Array:
    """Return the angles (M,) between pairs of rays (M, 2, 3), through the axis, up to 2π."""
    across = rays[:, 1, :2] - rays[:, 0, :2]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    sideways = np.einsum("mi,mei->me", across, rays[:, :, :2])
    angles = np.arctan2(sideways, rays[:, :, 2])
    return np.asarray(angles[:, 1] - angles[:, 0])


def rim(camera: Camera, per_edge: int = PER_EDGE, circle: ImageCircle | None = None) -> tuple[Array, Fold]:
    """Return the farthest pixels (4 · per_edge, 2) with a ray on the way from the principal point to the border, or to
    the image circle where it ends before that.

    The second is where the model folds on the way.
    """
    border, centre = _border(*camera.image_size, per_edge), np.array([camera.value("cx"), camera.value("cy")])
    border = border if circle is None else circle.clipped(centre, border)
    folded = ~camera.unproject(border).valid
    reach = border[folded] - centre
    low, high = np.zeros((len(reach), 1)), np.ones((len(reach), 1))
    for _ in range(HALVINGS if len(reach) else 0):
        middle = 0.5 * (low + high)
        valid = camera.unproject(centre + middle * reach).valid[:, None]
        low, high = np.where(valid, middle, low), np.where(valid, high, middle)
    farthest = border.copy()
    farthest[folded] = centre + low * reach
    nearest = np.linalg.norm(low * reach, axis=1).min(initial=math.inf)
    corner = np.linalg.norm(border - centre, axis=1).max()
    return farthest, Fold(bool(folded.any()), float(nearest), float(corner))


def _border(width: int, height: int, per_edge: int) -> Array:
    """Return pixels (4 · per_edge, 2) around the image, its corners among them."""
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    share = np.linspace(0, 1, per_edge, endpoint=False)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
