"""Where an image may show discs: regions darker or brighter than around them whose outline is an ellipse."""

from dataclasses import dataclass

import cv2
import numpy as np

from camcal.arrays import Array

_LEAST_POINTS = 8  # of an outline
_LEAST_AXIS = 1.2  # px, half the width of the flattest ellipse
_FLATTEST = 6.0  # long over short axis; a disc seen at 80°
_ROUND = 0.05  # spread of an outline about its ellipse, of the radius; 0.1 of a square
_ROUND_PX = 0.3  # that pixels add to it
_CONTRAST = 0.04  # of the image's range by which a disc must differ from its surroundings
_LEAST_CONTRAST = 3.0  # gray levels


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Ellipses x = centre + axes · u, |u| = 1: centres (N, 2), axes (N, 2, 2) symmetric, pixels."""

    centres: Array
    axes: Array

    @property
    def areas(self) -> Array:
        """Return the areas (N,) over π."""
        return np.asarray(np.linalg.det(self.axes))

    def take(self, rows: Array) -> "Ellipses":
        """Return some of the ellipses."""
        return Ellipses(self.centres[rows], self.axes[rows])

    def enlarged(self, scale: float) -> "Ellipses":
        """Return the ellipses as they are in an image `scale` times as large; pixel (0, 0) is a pixel's centre."""
        return Ellipses((self.centres + 0.5) * scale - 0.5, self.axes * scale)


def find_ellipses(gray: Array, block: int, *, bright: bool) -> Ellipses:
    """Return the ellipses of a gray image (H, W) uint8 that are darker, or brighter, than the mean over a block.

    block: side in pixels, odd.
    """
    smooth = cv2.GaussianBlur(gray, (0, 0), 0.8)
    low, high = np.percentile(smooth[::4, ::4], (2, 98))
    offset = max(_LEAST_CONTRAST, _CONTRAST * (high - low))
    image = cv2.bitwise_not(smooth) if bright else smooth
    mask = cv2.adaptiveThreshold(image, 1, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, offset)
    outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = 2 * min(gray.shape)
    kept = [np.asarray(line).reshape(-1, 2) for line in outlines if _LEAST_POINTS <= len(line) < longest]
    return _round(kept) if kept else Ellipses(np.zeros((0, 2)), np.zeros((0, 2, 2)))


def _round(outlines: list[Array]) -> Ellipses:
    """Return the ellipses of the outlines (K, 2) that are some; those of holes run the other way."""
    lengths = np.array([len(line) for line in outlines])
    points = np.concatenate(outlines).astype(np.float64)
    first = np.cumsum(lengths) - lengths
    areas, centres, seconds = _moments(points, first, lengths)
    kept = (areas > _LEAST_AXIS**2) & (np.linalg.det(seconds) > 0)
    axes = square_roots(np.where(kept[:, None, None], seconds, np.eye(2)))
    short, long = np.linalg.eigvalsh(axes).T
    kept &= (short > _LEAST_AXIS) & (long < _FLATTEST * short)
    inverse = np.linalg.inv(np.where(kept[:, None, None], axes, np.eye(2)))
    owner = np.repeat(np.arange(len(lengths)), lengths)
    away = np.einsum("nij,nj->ni", inverse[owner], points - centres[owner])
    off = np.add.reduceat((np.hypot(*away.T) - 1) ** 2, first) / lengths
    kept &= np.sqrt(off) < _ROUND + _ROUND_PX / short
    return Ellipses(centres[kept], axes[kept] + 0.5 * np.eye(2))  # outlines go through the centres of pixels


def _moments(points: Array, first: Array, lengths: Array) -> tuple[Array, Array, Array]:
    """Return areas (N,) px², centroids (N, 2) and squared axes (N, 2, 2) px² of the polygons that begin at `first`.

    Positive areas run as the outlines of regions do, holes are negative. Source: Green's theorem, as in Steger 1996,
    On the calculation of arbitrary moments of polygons.
    """
    origin = points[first]
    here = points - np.repeat(origin, lengths, axis=0)
    after = np.roll(here, -1, axis=0)
    after[first + lengths - 1] = here[first]
    cross = here[:, 1] * after[:, 0] - here[:, 0] * after[:, 1]
    areas = np.add.reduceat(cross, first) / 2
    scale = np.where(areas == 0, np.inf, areas)[:, None]
    centroids = np.add.reduceat((here + after) * cross[:, None], first) / (6 * scale)
    both = here + after
    products = np.stack([_product(here, after, both, i, j) for i, j in ((0, 0), (0, 1), (1, 1))], axis=1)
    xx, xy, yy = (np.add.reduceat(products * cross[:, None], first) / (24 * scale)).T
    seconds = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    seconds -= centroids[:, :, None] * centroids[:, None, :]
    return areas, centroids + origin, 4 * seconds


def _product(here: Array, after: Array, both: Array, i: int, j: int) -> Array:
    return np.asarray(here[:, i] * here[:, j] + after[:, i] * after[:, j] + both[:, i] * both[:, j])


def square_roots(matrices: Array) -> Array:
    """Return the square roots (N, 2, 2) of symmetric positive matrices (N, 2, 2)."""
    root = np.sqrt(np.linalg.det(matrices))[:, None, None]
    trace = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    return np.asarray((matrices + root * np.eye(2)) / np.sqrt(trace + 2 * root))  # Cayley and Hamilton
