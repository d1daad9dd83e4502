"""The image circle of a circular fisheye, detected in images: the illuminated disc of the image.

What the scene leaves dark in one photograph is bright in another: the pixelwise maximum of several is searched. The
circle is where it crosses a threshold; where the light falls off gradually, some light is left beyond.
Sources: Fischler & Bolles, Random Sample Consensus, Communications of the ACM 24, 1981; Gander, Golub & Strebel,
Least-squares fitting of circles and ellipses, BIT 34, 1994.
"""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.opencv import largest_region, resized

MOST_IMAGES = 24  # of one camera; more change next to nothing

_WIDTH = 400  # px of the reduced images, the pixels of everything below
_RANGE = (1, 99)  # percentiles of the pixels
_LEAST_RANGE = 8  # levels; less is noise
_DARK = 0.2  # of the brightest: the darkest pixels are no brighter where no light falls
_THRESHOLDS = (0.25, 0.12)  # of the range; scenes that are dark at the rim need the lower one
_BORDER = 2.0  # px along the image border where no outline counts: the disc is cut off there, or a black line runs
_SMALLEST = 0.25  # of the shorter side: circles of smaller radii are things in the scene
_OFF_CENTRE = 0.25  # of the width and height, from the middle of the image: circles farther off are, too
_TOLERANCE = 0.01  # radii from the circle, of the outline points that it is fitted to
_TRIPLETS, _BATCH = 2048, 256  # one without outliers is among them at 1 - e⁻⁷ if 15 % of the points are on the circle
_SCORED = 600  # outline points that score the circles of triplets
_FEWEST = 20  # outline points on a circle
_ROUNDS, _SETTLED = 50, 1e-4  # of the fit, and its last step in px
_SECTORS = 180  # of the whole circle
_RIM = 0.03  # radii from the circle, of outline points that support it; farther out it must be dark
_LEAST_ARC = np.pi / 2
_LEAST_SUPPORTED = 0.75  # of the visible arc
_LEAST_DARK = 0.95  # of the pixels beyond the rim
_LEAST_CORNERS = 2
_ENDS = (slice(None, 3), slice(-3, None))  # rows and columns of the patches in the image corners
_CORNERS = tuple((rows, columns) for rows in _ENDS for columns in _ENDS)


@dataclass(frozen=True)
class MeasuredCircle(ImageCircle):
    """An image circle as it was measured.

    visible_arc: rad of the circle that lie inside the image. supported: share of them along which the outline of the
    bright region is within 3 % of the radius from the circle. rms: px, distances of the outline points that the circle
    is fitted to. dark_outside: share of the image's pixels beyond 1.03 radii that are dark. dark_corners: of the image.
    """

    visible_arc: float
    supported: float
    rms: float
    dark_outside: float
    dark_corners: int


class ImageCircleSearch:
    """Takes the photographs of one camera one by one and keeps only their maximum, reduced to 400 px of width."""

    def __init__(self) -> None:
        self._shape: tuple[int, ...] = ()
        self._brightest: Array | None = None

    def add(self, image: Array) -> None:
        """Take an image (H, W) uint8 or uint16, of the same size and type as the first one.

        Raises InvalidInput for any other.
        """
        if image.ndim != 2 or not image.size or image.dtype not in (np.uint8, np.uint16):
            raise InvalidInput(f"an image is (H, W) uint8 or uint16, found {image.dtype} of the shape {image.shape}")
        if self._brightest is None:
            self._shape = image.shape
        elif (image.shape, image.dtype) != (self._shape, self._brightest.dtype):
            raise InvalidInput(
                f"images have one size and type, found {image.dtype} of the shape {image.shape}"
                f" after {self._brightest.dtype} of the shape {self._shape}"
            )
        reduced = resized(image, _scale(image.shape))
        self._brightest = reduced if self._brightest is None else np.maximum(self._brightest, reduced)

    @property
    def ruled_out(self) -> bool:
        """Whether there is no image circle, whatever further images show: what is bright stays bright."""
        if self._brightest is None:
            return False
        brightest_possible = float(np.iinfo(self._brightest.dtype).max)
        return bool(np.percentile(self._brightest, _RANGE[0]) > _DARK * brightest_possible)

    def result(self) -> MeasuredCircle | None:
        """Return the image circle; None if the images so far, or no images, show none."""
        circle = None if self._brightest is None else _find_circle(self._brightest.astype(float))
        if circle is None:
            return None
        scale = _scale(self._shape)
        x, y = ((place + 0.5) / scale - 0.5 for place in circle.centre)
        return replace(
            circle,
            image_size=(self._shape[1], self._shape[0]),
            centre=(x, y),
            radius=circle.radius / scale,
            rms=circle.rms / scale,
        )


def evenly_spaced(count: int, most: int = MOST_IMAGES) -> list[int]:
    """Return the indices of at most `most` of `count` images, evenly spaced from the first to the last."""
    return [int(index) for index in np.linspace(0, count - 1, min(count, most)).round()]


def _scale(shape: tuple[int, ...]) -> float:
    """Return by how much images (H, W) are reduced: to 400 columns, and to one row at least."""
    return min(1.0, max(_WIDTH / shape[1], 1 / shape[0]))


def _find_circle(brightest: Array) -> MeasuredCircle | None:
    """Return the image circle of an image (h, w) in its own pixels: of those accepted the best supported one."""
    low, high = np.percentile(brightest, _RANGE)
    if high - low < _LEAST_RANGE or low > _DARK * high:
        return None
    accepted = []
    for share in _THRESHOLDS:
        threshold = float(low + share * (high - low))
        points = _outline(brightest, threshold)
        start = _best_of_triplets(points, brightest.shape)
        fitted = None if start is None else _fit_circle(points, start, brightest.shape)
        circle = None if fitted is None else _describe(fitted, points, brightest, threshold)
        if circle is not None and _is_image_circle(circle):
            accepted.append(circle)
    return max(accepted, key=lambda circle: circle.supported, default=None)


def _is_image_circle(circle: MeasuredCircle) -> bool:
    return (
        circle.visible_arc >= _LEAST_ARC
        and circle.supported >= _LEAST_SUPPORTED
        and circle.dark_outside > _LEAST_DARK
        and circle.dark_corners >= _LEAST_CORNERS
    )


def _outline(brightest: Array, threshold: float) -> Array:
    """Return where (N, 2) px the outline of the largest bright region crosses rows and columns, off the image border.

    Holes are part of the region. Places between two pixels are interpolated linearly.
    """
    region = largest_region(brightest >= threshold)
    along_rows = _crossings(region, brightest, threshold)
    along_columns = _crossings(region.T, brightest.T, threshold)[:, ::-1]
    points = np.concatenate([along_rows, along_columns])
    return np.asarray(points[_off_border(points, brightest.shape)])


def _crossings(region: Array, values: Array, threshold: float) -> Array:
    """Return where (N, 2) x, y the values (h, w) cross the threshold along rows that enter or leave a region (h, w)."""
    rows, columns = np.nonzero(region[:, 1:] != region[:, :-1])
    left, right = values[rows, columns], values[rows, columns + 1]
    return np.column_stack([columns + (threshold - left) / (right - left), rows])


def _off_border(points: Array, shape: tuple[int, ...]) -> Array:
    """Return the mask (N,) of the points (N, 2) that lie inside an image (h, w) and off its border."""
    low, high = _BORDER - 0.5, np.array(shape[::-1]) - 0.5 - _BORDER
    return np.asarray(((points > low) & (points < high)).all(axis=1))


def _best_of_triplets(points: Array, shape: tuple[int, ...]) -> Array | None:
    """Return the circle (3,) x, y, radius through three random points (N, 2) that most points lie near."""
    if len(points) < _FEWEST:
        return None
    rng = np.random.default_rng(0)
    scoring = rng.permutation(points)[:_SCORED]
    best, most = None, 0
    for _ in range(_TRIPLETS // _BATCH):
        circles = _circles_through(points[rng.integers(len(points), size=(_BATCH, 3))])
        circles = circles[_is_possible(circles, shape)]
        counts = (np.abs(_deviations(scoring, circles)) < _TOLERANCE).sum(axis=1)
        if counts.size and counts.max() > most:
            best, most = circles[int(np.argmax(counts))], int(counts.max())
    return best


def _circles_through(triplets: Array) -> Array:
    """Return the circles (N, 3) x, y, radius through three points each (N, 3, 2); not finite for points on a line."""
    first, second, third = np.moveaxis(triplets, 1, 0)
    (ax, ay), (bx, by) = (second - first).T, (third - first).T
    a, b = ax * ax + ay * ay, bx * bx + by * by
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = np.column_stack([by * a - ay * b, ax * b - bx * a]) / (2 * (ax * by - ay * bx))[:, None]
    return np.column_stack([first + offset, np.hypot(offset[:, 0], offset[:, 1])])


def _is_possible(circles: Array, shape: tuple[int, ...]) -> Array:
    """Return the mask (N,) of the circles (N, 3) with the centre near that of an image (h, w), not too small for it."""
    size = np.array(shape[::-1])
    off_centre = np.abs(circles[:, :2] - (size - 1) / 2)
    return np.asarray((off_centre <= _OFF_CENTRE * size).all(axis=1) & (circles[:, 2] >= _SMALLEST * min(shape)))


def _deviations(points: Array, circles: Array) -> Array:
    """Return how far (M, N) points (N, 2) lie outside of circles (M, 3), in radii."""
    apart = points - circles[:, None, :2]
    return np.asarray(np.hypot(apart[..., 0], apart[..., 1]) / circles[:, 2:] - 1)


def _fit_circle(points: Array, circle: Array, shape: tuple[int, ...]) -> Array | None:
    """Return the circle (3,) of least squared distances from the points (N, 2) near it; None if none is left.

    Each step of Gauss and Newton (Gander, Golub & Strebel 1994, section 3) takes the points near the circle of the
    last one; a point that comes and goes moves the circle by far less than a pixel.
    """
    for _ in range(_ROUNDS):
        near = points[np.abs(_deviations(points, circle[None])[0]) < _TOLERANCE]
        if len(near) < _FEWEST or not _is_possible(circle[None], shape)[0]:
            return None
        apart = near - circle[:2]
        distances = np.hypot(apart[:, 0], apart[:, 1])
        jacobian = np.column_stack([apart / distances[:, None], np.ones(len(near))])
        step = np.linalg.lstsq(jacobian, distances - circle[2], rcond=None)[0]
        circle = circle + step
        if np.abs(step).max() < _SETTLED:
            break
    return circle


def _describe(circle: Array, points: Array, brightest: Array, threshold: float) -> MeasuredCircle:
    """Return a circle (3,) with the measures that tell an image circle, of an outline (N, 2) in an image (h, w)."""
    deviations = _deviations(points, circle[None])[0]
    fitted = deviations[np.abs(deviations) < _TOLERANCE]
    directions = (np.arange(_SECTORS) + 0.5) * (2 * np.pi / _SECTORS)
    rim = circle[:2] + circle[2] * np.column_stack([np.cos(directions), np.sin(directions)])
    visible = _off_border(rim, brightest.shape)
    across, down = (points[np.abs(deviations) < _RIM] - circle[:2]).T
    sectors = np.floor(np.arctan2(down, across) / (2 * np.pi) * _SECTORS).astype(int) % _SECTORS
    supported = np.isin(np.arange(_SECTORS), sectors)
    rows, columns = np.indices(brightest.shape)
    radii = np.hypot(columns - circle[0], rows - circle[1]) / circle[2]
    outside = brightest[radii > 1 + _RIM]
    return MeasuredCircle(
        image_size=(brightest.shape[1], brightest.shape[0]),
        centre=(float(circle[0]), float(circle[1])),
        radius=float(circle[2]),
        visible_arc=float(visible.mean() * 2 * np.pi),
        supported=float(supported[visible].mean()) if visible.any() else 0.0,
        rms=float(np.sqrt(np.mean(fitted**2)) * circle[2]) if fitted.size else np.inf,
        dark_outside=float((outside < threshold).mean()) if outside.size else 0.0,
        dark_corners=sum(bool(radii[at].min() > 1 and np.median(brightest[at]) < threshold) for at in _CORNERS),
    )
