"""Candidate tags of an AprilGrid in reduced copies of an image, and the agreement of their bits.

A tag is a dark quadrilateral with a bright gap around it. At its corners it touches the small black squares of the
print, but only there, so that a threshold somewhat below the local mean keeps them apart. Bits are never decided one by
one: a blurred tag agrees with its code as a whole, and a board does with all its tags together.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from camcal import opencv
from camcal.arrays import Array, readonly
from camcal.targets.board_types import TAG_BORDER
from camcal.targets.markers.families import family_named

_SMALL, _MEDIUM, _LARGE, _TINY = 0.5e6, 1.5e6, 6e6, 0.12e6  # pixels of the copies
_ENLARGEMENTS = ((1.5e6, 1.6), (0.8e6, 2.5))  # of images with fewer pixels
_LEAST_SIDE_PX = 8.0
_STRAIGHT = 0.05  # of its length, how far an outline may be from a quadrilateral
_STUCK_OUT = 0.25  # of half a diagonal; the small square is 0.6 of it with Kalibr's usual gap
_OUTLINE_PX = 1.5  # how far its corners may be from the tag's
_MIDDLES = 0.15  # a cell is read by four samples so far from its middle, in cells
_BEYOND_DOUBT = 0.85  # of the correlation of a tag's bits, out of all codes and turns
_LEAST_CONTRAST = 2.0  # gray levels, standard deviation of a tag's bits


@dataclass(frozen=True, eq=False)
class Quadrilaterals:
    """Dark quadrilaterals at corners (Q, 4, 2) px, clockwise; off_px: how far off the corners of a tag may be."""

    corners: Array
    off_px: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", readonly(self.corners, (None, 4, 2), "corners"))


def quadrilaterals(gray: Array) -> Iterator[Quadrilaterals]:
    """Yield what may be tags in `gray`, (H, W) uint8, each time from another copy or threshold, the quick ones first.

    Structure takes few pixels, and blur is narrow in a small copy; large copies and enlarged ones show the small tags.
    """
    for scale, block, drop in _attempts(gray.size):
        copy = gray if scale == 1 else opencv.resized(gray, scale)
        to_image = np.array(gray.shape[::-1]) / np.array(copy.shape[::-1])
        corners = (_dark_quadrilaterals(copy, block, drop) + 0.5) * to_image - 0.5
        yield Quadrilaterals(corners, _OUTLINE_PX * float(to_image.max()))


def _attempts(size: int) -> Iterator[tuple[float, int, float]]:
    """Yield the scale of a copy, and the threshold's neighbourhood and drop below its mean, for so many pixels."""
    small, medium, large, tiny = (min(1.0, float(np.sqrt(p / size))) for p in (_SMALL, _MEDIUM, _LARGE, _TINY))
    yield from ((small, 3, 7.0), (small, 3, 3.0))
    if small < 1:
        yield from ((medium, 3, 7.0), (medium, 5, 5.0))
    else:
        yield (small, 5, 5.0)
    yield from ((scale, 5, 5.0) for limit, scale in _ENLARGEMENTS if size < limit)
    if medium < 1:
        yield (large, 3, 7.0)
    yield from ((tiny, 3, 3.0), (small, 9, 3.0))


def _dark_quadrilaterals(gray: Array, block: int, drop: float) -> Array:
    """Return the corners (Q, 4, 2) px of dark convex quadrilaterals, clockwise."""
    dark = cv2.adaptiveThreshold(gray, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, block, drop)
    outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    longest = 2 * sum(gray.shape)
    found = []
    for outline in outlines:
        if not 4 * _LEAST_SIDE_PX <= len(outline) <= longest:
            continue
        corners = cv2.approxPolyDP(outline, _STRAIGHT * len(outline), closed=True)
        if len(corners) == 4 and cv2.isContourConvex(corners):
            found.append(corners.reshape(4, 2))
    return _mended(_clockwise(np.array(found, dtype=np.float64).reshape(-1, 4, 2)))


def _clockwise(corners: Array) -> Array:
    """Return quadrilaterals (Q, 4, 2) with their corners in clockwise order (y is down), without slits."""
    turned = _cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]) < 0
    ordered = np.where(turned[:, None, None], corners[:, ::-1], corners)
    sides = np.linalg.norm(ordered - np.roll(ordered, 1, axis=1), axis=2)
    return np.asarray(ordered[sides.min(axis=1) >= _LEAST_SIDE_PX / 2])


def _mended(corners: Array) -> Array:
    """Return quadrilaterals (Q, 4, 2) whose one corner that sticks out, if any, is put where it makes a parallelogram.

    Where noise joins a tag with the small square at its corner the outline runs around both.
    """
    away = corners - corners.mean(axis=1, keepdims=True)
    size = np.linalg.norm(away, axis=2)
    excess = (away[:, 0] - away[:, 1] + away[:, 2] - away[:, 3])[:, None] * np.array([1, -1, 1, -1])[:, None]
    outward = (excess * away).sum(axis=2) / np.maximum(size, 1e-9)
    place = np.arange(len(corners)), outward.argmax(axis=1)
    long = outward[place] > np.maximum(_STUCK_OUT * size.mean(axis=1), 0.9 * np.linalg.norm(excess[:, 0], axis=1))
    mended = corners.copy()
    mended[place] -= np.where(long[:, None], excess[place], 0.0)
    return mended


@cache
def codes_of(dictionary: str) -> Array:
    """Return the bits (ids, n, n) of a family's tags, upright as printed: 1 is white."""
    family = family_named(dictionary)
    return readonly(family.printed(range(family.count))[:, 1:-1, 1:-1], (None, None, None), "bits")


def bit_agreement(gray: Array, corners: Array, codes: Array) -> Array:
    """Return the correlation (M, K) of what is seen of tags with codes (K, n, n), 0 where nothing is seen.

    corners: (M, 4, 2) px, clockwise from the upper left as the codes are turned. Of what is no tag at all the
    correlations scatter by 1/n about 0.
    """
    seen = _cells(gray, corners, codes.shape[-1]).reshape(len(corners), codes[0].size)
    seen = seen - seen.mean(axis=1, keepdims=True)
    spread = seen.std(axis=1, keepdims=True)
    seen = np.where(spread > _LEAST_CONTRAST, seen / np.where(spread > 0, spread, 1.0), 0.0)
    expected = codes.reshape(len(codes), -1).astype(np.float64)
    expected -= expected.mean(axis=1, keepdims=True)
    expected /= expected.std(axis=1, keepdims=True)
    return np.asarray(np.nan_to_num(seen) @ expected.T / expected.shape[1])


def read_tags(gray: Array, corners: Array, codes: Array) -> tuple[Array, Array]:
    """Return the ids, ascending, of codes (K, n, n) that quadrilaterals show beyond doubt, and the corners of these.

    corners: (Q, 4, 2) px; those that are returned (P, 4, 2), in no order of the ids.
    """
    agreement = np.stack([bit_agreement(gray, np.roll(corners, turns, axis=1), codes) for turns in range(4)])
    _, shown, ids = np.nonzero(np.asarray(agreement > _BEYOND_DOUBT))
    return np.unique(ids), corners[np.unique(shown)]


def _cells(gray: Array, corners: Array, side: int) -> Array:
    """Return the gray values (M, side, side) of the cells within the borders of tags, NaN out of the image."""
    cells = side + 2 * TAG_BORDER
    steps = (TAG_BORDER + 0.5 + np.arange(side)) / cells
    x, y = (values[..., None] for values in np.meshgrid(steps, steps))
    shift = np.array([-1, 1]) * _MIDDLES / cells
    shift_x, shift_y = (values.ravel() for values in np.meshgrid(shift, shift))
    places = np.stack([x + shift_x, y + shift_y], axis=-1).reshape(-1, 2)
    return np.asarray(_values(gray, _within(corners, places)).reshape(-1, side, side, 4).mean(axis=-1))


def _within(corners: Array, places: Array) -> Array:
    """Return the pixels (M, P, 2) of places (P, 2) of a unit square whose corners are seen at (M, 4, 2).

    Source: Heckbert, Fundamentals of Texture Mapping and Image Warping, 1989, section 2.2.3.
    """
    first, second, third, fourth = np.moveaxis(corners, 1, 0)
    one, two, skew = second - third, fourth - third, first - second + third - fourth
    area = _cross(one, two)
    area = np.where(np.abs(area) < 1e-9, np.nan, area)
    g, h = (_cross(skew, two) / area)[:, None], (_cross(one, skew) / area)[:, None]
    along, down = second - first + g * second, fourth - first + h * fourth
    x, y = places[:, 0], places[:, 1]
    depth = 1 + g * x + h * y
    flat = along[:, None] * x[:, None] + down[:, None] * y[:, None] + first[:, None]
    return np.asarray(flat / np.where(depth > 0, depth, np.nan)[..., None])


def _cross(one: Array, two: Array) -> Array:
    return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])


def _values(gray: Array, places: Array) -> Array:
    """Return the gray values (M, P) at places (M, P, 2) px between pixels, NaN out of the image."""
    inside = np.all((places >= 0) & (places <= np.array(gray.shape[::-1]) - 1), axis=-1)
    x, y = np.moveaxis(np.where(inside[..., None], places, 0.0), -1, 0)
    return np.where(inside, opencv.sampled(gray, x, y), np.nan)
