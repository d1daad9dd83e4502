"""Valid region of a camera: image circle, domain of the lens model, field of view, pixel size.

The size of a pixel is the angle it sees, or its side on a plane in front of the camera, through the lens's rays.
"""

import math
from functools import lru_cache

import numpy as np

from camcal.arrays import Array, BoolArray, readonly
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass

PER_EDGE = 16  # samples of each edge of the image: a corner and those towards the next one
_INSIDE = 1e-6  # of a line: so far inside of where a lens folds it surely has a ray
ROUNDS, _PARTS = 5, 16  # a segment across the image is divided in turns: to a millionth of it
_HALF = 0.25  # px to either side of a pixel's centre: derivatives to 1e-6, and corners stay inside the image


@dataclass(frozen=True)
class ImageCircle:
    """The disc of a camera's image that its lens lights; beyond it, the image is black.

    image_size: (width, height) px. centre: (x, y) px, (0, 0) is the centre of the top-left pixel. radius: px.
    """

    image_size: tuple[int, int]
    centre: tuple[float, float]
    radius: float

    @property
    def words(self) -> str:
        """Radius and centre in a line."""
        x, y = self.centre
        return f"image circle of radius {self.radius:.1f} px around ({x:.1f}, {y:.1f})"

    def contains(self, pixels: Array) -> BoolArray:
        """Return the mask (...) of pixels (..., 2) inside the circle; those that are NaN are not."""
        apart = pixels - np.array(self.centre)
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]) <= self.radius)

    def clipped(self, start: Array, ends: Array) -> BoolArray:
        """Return ends (N, 2) of lines from `start` (2,), px, those outside of the circle moved along their line to it.

        All stay where they are if the start itself is outside.
        """
        outside = ~self.contains(ends)
        if not self.contains(start) or not outside.any():
            return ends
        away, lines = start - np.array(self.centre), ends[outside] - start
        # |away + s line| = radius, a quadratic equation in s with one root from 0 to 1
        squares, slopes = (lines**2).sum(axis=1), lines @ away
        roots = np.sqrt(slopes**2 + squares * (self.radius**2 - away @ away))
        result = np.array(ends, dtype=float)
        result[outside] = start + ((roots - slopes) / squares)[:, None] * lines
        return result

    def resized(self, size: tuple[int, int]) -> "ImageCircle":
        """Return the circle in images resized to (width, height)."""
        across, down = (new / old for new, old in zip(size, self.image_size, strict=True))
        x, y = self.centre
        centre = ((x + 0.5) * across - 0.5, (y + 0.5) * down - 0.5)
        return ImageCircle(size, centre, self.radius * float(np.sqrt(across * down)))


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
    return rim(camera, circle=circle, nearest_only=True)[1]


def valid_block(camera: Camera, circle: ImageCircle | None = None) -> dict[str, float]:
    """Return max_theta_deg, unless rays are parallel, and max_radius_px: how far from the axis the model holds, as far
    as there is an image.
    """
    border, fold = rim(camera, circle=circle)
    reach = {"max_radius_px": min(fold.radius_px, fold.corner_px)}
    if not camera.model.is_central:
        return reach
    rays = camera.unproject(border).directions
    theta = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return {"max_theta_deg": float(np.degrees(np.nanmax(theta))), **reach}


def field_of_view(camera: Camera, circle: ImageCircle | None = None) -> tuple[float, float, float]:
    """Return the horizontal, vertical and diagonal field of view (rad), to the outer edges of the pixels.

    Horizontal and vertical are taken through the middle of the image, the diagonal is the larger of the two; to the
    image circle where it ends before the image. NaN where the model has no ray for an edge. Lenses beyond 180° are
    counted in full.
    """
    return _fields(camera.unproject(_edges(camera, circle)).directions)


def field_and_fold(camera: Camera, circle: ImageCircle | None = None) -> tuple[float, Fold]:
    """Return the horizontal field of view of `field_of_view`, and what `folds_inside` does, of one unprojection."""
    edges = _edges(camera, circle)[:2]
    border = border_pixels(*camera.image_size)
    border = border if circle is None else circle.clipped(np.array([camera.value("cx"), camera.value("cy")]), border)
    radial = _is_radial(camera)  # where it folds, its domain says
    rays = camera.unproject(edges if radial else np.concatenate([edges, border]))
    _, fold = rim(camera, circle=circle, nearest_only=True, seen=None if radial else rays.valid[2:])
    return float(_openings(rays.directions[None, :2])[0]), fold


def _edges(camera: Camera, circle: ImageCircle | None) -> Array:
    """Return the places (8, 2) between which `field_of_view` is, pairs across, down and along the diagonals."""
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
    return edges if circle is None else circle.clipped(np.array([middle_x, middle_y]), edges)


def _fields(rays: Array) -> tuple[float, float, float]:
    """Return what `field_of_view` does, of the rays (8, 3) of `_edges`."""
    horizontal, vertical, falling, rising = _openings(rays.reshape(4, 2, 3)).tolist()
    return horizontal, vertical, float(np.maximum(falling, rising))


def _openings(rays: Array) -> Array:
    """Return the angles (M,) between pairs of rays (M, 2, 3), through the axis, up to 2π."""
    across = rays[:, 1, :2] - rays[:, 0, :2]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across /= np.where(length > 0, length, np.nan)  # no angle is between parallel rays
    sideways = np.einsum("mi,mei->me", across, rays[:, :, :2])
    angles = np.arctan2(sideways, rays[:, :, 2])
    return np.asarray(angles[:, 1] - angles[:, 0])


def rim(
    camera: Camera,
    per_edge: int = PER_EDGE,
    circle: ImageCircle | None = None,
    *,
    nearest_only: bool = False,
    seen: Array | None = None,
) -> tuple[Array, Fold]:
    """Return the farthest pixels (4 · per_edge, 2) with a ray on the way from the principal point to the border, or to
    the image circle where it ends before that.

    The second is where the model folds on the way. nearest_only: the farthest pixels are known roughly, but where it
    folds nearest to the principal point. seen: the mask (4 · per_edge,) of places on the border with a ray, if known.
    """
    border, centre = border_pixels(*camera.image_size, per_edge), np.array([camera.value("cx"), camera.value("cy")])
    border = border if circle is None else circle.clipped(centre, border)
    within = _radial_shares(camera, border - centre)
    folded = ~(camera.unproject(border).valid if seen is None else seen) if within is None else within < 1
    reach = border[folded] - centre
    low, width = np.zeros((len(reach), 1)), 1.0
    length = np.linalg.norm(reach, axis=1)
    shares = np.arange(1, _PARTS) / _PARTS
    if within is not None:
        low = within[folded, None]
    for _ in range(ROUNDS if len(reach) and within is None else 0):
        # of lines that fold farther away than another one at most, the place does not matter
        near = low[:, 0] * length <= ((low[:, 0] + width) * length).min() if nearest_only else length > 0
        tried = centre + (low[near] + width * shares)[..., None] * reach[near][:, None]
        valid = camera.unproject(tried.reshape(-1, 2)).valid.reshape(len(tried), -1)
        width /= _PARTS
        low[near] += width * np.cumprod(valid, axis=1).sum(axis=1, keepdims=True)
    farthest = border.copy()
    farthest[folded] = centre + low * reach
    nearest = (low[:, 0] * length).min(initial=math.inf)
    corner = np.linalg.norm(border - centre, axis=1).max()
    return farthest, Fold(bool(folded.any()), float(nearest), float(corner))


def _radial_shares(camera: Camera, reach: Array) -> Array | None:
    """Return how much of lines (N, 2) from the principal point, px, a lens covers whose distortion is along the radius.

    None for any other lens.
    """
    if not _is_radial(camera):
        return None
    focal = camera.value("fx"), camera.value("fy")
    largest = camera.model.domain(camera.parameters).max_radius_px / min(focal)
    radii = np.hypot(*(reach / focal).T)
    return np.asarray(np.where(radii < largest, 1.0, (1 - _INSIDE) * largest / np.maximum(radii, _INSIDE)))


def _is_radial(camera: Camera) -> bool:
    """Return whether the distortion is along the radius alone, with as many terms as there are."""
    values = dict(zip(camera.model.parameter_names, camera.parameters.tolist(), strict=True))
    return not camera.model.is_view and "k1" in values and not any(values[key] for key in values if key[0] not in "fck")


@lru_cache(maxsize=8)  # files of one size come many at a time
def border_pixels(width: int, height: int, per_edge: int = PER_EDGE) -> Array:
    """Return pixels (4 · per_edge, 2) around the image, its corners among them; they cannot be written to."""
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=float)
    share = np.linspace(0, 1, per_edge, endpoint=False)[:, None]
    edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return readonly(np.concatenate(edges), (None, 2), "border")


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
    left, right, top, bottom = _on_plane(camera.unproject(ends).at(), distance)
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
