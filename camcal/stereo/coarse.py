"""Coarse correspondences of a pair: two passes at reduced size, the first over the whole range.

From the coarse map comes the range of disparities to search. Features that both images share say where to compare
their rows, their exposure and their order.
"""

import math
from math import ceil, floor, sqrt
from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array, readonly, require_shape
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.opencv import remap, resized

SEARCH_WIDTHS = (128, 256)  # px of width; the first look is for all disparities up to half the width, either sign

_WIDENED = 0.15  # of the span of the first look, on either side, for the second
_WINDOW = 9  # px; larger than texture, smaller than what light does to a surface
_FLAT = 2.0  # counts; contrast below the noise of a camera is not made into texture
_CONTRAST = 40.0  # counts of the 8 bits that are matched for one standard deviation
_STEP = 16  # fixed point of OpenCV's disparities, and what their number must be a multiple of
_BLOCK = 3
_SMALL_STEP, _LARGE_STEP = 8 * _BLOCK**2, 32 * _BLOCK**2  # penalties OpenCV's manual suggests
_UNIQUE = 5  # percent by which the best match beats the second
_ALIKE = 0.6  # correlation of what is matched; lower where a match is wrong, or in shadow, or in noise
_SURROUNDINGS = (5, 5)  # px, of what is correlated
_SHORTEST, _LONGEST = 2, 1 / 6  # pixels, and share of the width, after which texture may repeat itself
_UNREPEATED = 0.1  # share of the matches; where fewer are of texture that does not repeat itself, it is periodic
_NOTHING = 1e-6  # of the contrast 1 that is left by rounding
_PATCHES = (8, 25)  # px of a look that agree on a disparity, at least
_BODY = (0.05, 0.95)  # quantiles of the disparities that bound what all of the scene but its ends has
_BANDS = 1 / 3  # of the width; more is no band at the side of the image any more
_JOINED, _ENOUGH = 1.5, 25  # px between neighbours of a patch, and how much of it beside a band vouches for the rest
_BEHIND, _MOSTLY = -2.0, 10  # px, and how many times as many matches lie before it; what is left is chance
_WIDENING_SHARE = 0.007  # share of the matches that makes a range worth widening by its own span
_NEARLY_ALL, _LEAST_SPAN = (0.02, 0.98), 2.0  # quantiles, and pixels, of that span
_FEWEST = 50  # matches
_FEWEST_SHARE = 0.02  # of the pixels; noise alone gives fewer
_FAR, _NEAR = 0.04, 0.12  # margins, of the span: what is missed at reduced size is thin and stands in front
_DEFAULT_SHARE = 1 / 6  # of the width

# features
PIXELS = 1e6  # of the image features are searched for in; they are found to a part of a pixel that is as large there
_MOST = 1500  # features of an image; more make the trend of the rows no surer than it is already
_FEATURE_CONTRAST = 0.01  # SIFT's own limit is 0.04, too much for dark images; the strongest are taken anyway


class CoarseMap(NamedTuple):
    """Disparities (h, w) float32 of the left image reduced to 256 columns, pixels of the image itself.

    Good to about a column of the map; NaN where unknown or outside the range that texture which does not repeat itself
    shows, and everywhere if too little can be matched. periodic: next to all that is matched resembles other places of
    its row, so that all of it may be off by a period.
    """

    disparities: Array
    periodic: bool


def coarse_map(left: Array, right: Array) -> CoarseMap:
    """Return roughly where the pixels of the left image are in the right one.

    left, right: (H, W) uint8, rows aligned to a few pixels. Raises InvalidInput for images of different sizes.
    """
    pairs = [require_pair(left, right)]
    for width in reversed(SEARCH_WIDTHS):
        pairs.append((_reduced(pairs[-1][0], width), _reduced(pairs[-1][1], width)))
    nothing = CoarseMap(np.full(pairs[1][0].shape, np.nan, np.float32), False)
    if left.shape[1] < _WINDOW:  # which no window fits in, and in which OpenCV's matcher may divide by zero
        return nothing
    low, high = -left.shape[1] / 2, left.shape[1] / 2
    found, result = nothing.disparities, nothing
    for index, ((first, second), smallest) in enumerate(zip(reversed(pairs[1:]), _PATCHES, strict=True)):
        scale = left.shape[1] / first.shape[1]
        wider = _WIDENED * (high - low) + 2 * scale if index else 0.0
        look = math.floor((low - wider) / scale), math.ceil((high + wider) / scale)
        even = locally_normalised(first)
        found = scale * _matched(even, locally_normalised(second), look, smallest)
        known = np.isfinite(found)
        if known.sum() < _least(found.size):
            return nothing
        single = known & ~_repeated(even, min(look[1] - look[0], round(_LONGEST * even.shape[1])))
        # Stripes match as well a period off, all of them together, which no test of a match tells. Where the first look
        # knows nothing else, the second knows no better: its range is one of several.
        few = single.sum() < _least(known.size)
        result = CoarseMap(found, result.periodic or bool(few and single.sum() < _UNREPEATED * known.sum()))
        low, high = worthwhile_range(_before_the_cameras(found[known if few or result.periodic else single]))
    found[(found < low) | (found > high)] = np.nan
    return result


def _before_the_cameras(disparities: Array) -> Array:
    """Return disparities (N,) without those below zero, pixels, where next to all are above it."""
    before = disparities >= _BEHIND
    few = before.sum() >= _MOSTLY * (len(disparities) - before.sum())
    return disparities[before] if few else disparities


def worthwhile_range(disparities: Array) -> tuple[float, float]:
    """Return the range that holds most matches for its width: a stretch at an end must hold its share, or is left out.

    A stray match far off would widen the range more than all else; a small thing near the rest widens it little.
    """
    ordered = np.sort(disparities)
    middle = ordered.size // 2
    span = max(float(np.ptp(np.quantile(ordered, _NEARLY_ALL))), _LEAST_SPAN)
    held = np.arange(ordered.size) / ordered.size - _WIDENING_SHARE / span * ordered
    return float(ordered[np.argmin(held[: middle + 1])]), float(ordered[middle + np.argmax(held[middle:])])


def locally_normalised(gray: Array) -> Array:
    """Return an image with mean 0 and contrast 1 in every window, so that exposure no longer matters."""
    window = (_WINDOW, _WINDOW)
    values = gray.astype(np.float32)
    values -= cv2.blur(values, window)
    return np.asarray(values / cv2.sqrt(cv2.blur(values * values, window) + np.float32(_FLAT**2)))


def as_counts(image: Array) -> Array:
    """Return an evened image as uint8: 40 counts for one standard deviation."""
    return np.asarray(cv2.convertScaleAbs(np.maximum(image + 128 / _CONTRAST, 0), alpha=_CONTRAST))


def even_out(gray: Array, side: int) -> Array:
    """Return an image as `as_counts` of a local normalisation in windows of a side, whose means and contrasts are taken
    at half the size: they vary slowly.
    """
    small = halve(gray).astype(np.float32)
    window = (side // 2 | 1,) * 2
    mean: Array = cv2.blur(small, window)
    power = cv2.blur(small * small, window) - mean * mean
    gain: Array = _CONTRAST / cv2.sqrt(np.maximum(power, 0) + np.float32(_FLAT**2))
    size = gray.shape[::-1]
    even = (gray - cv2.resize(mean, size)) * cv2.resize(gain, size)
    return np.asarray(cv2.convertScaleAbs(np.maximum(even + 128, 0)))


def halve(gray: Array) -> Array:
    """Return an image at half its size, of at least a pixel."""
    height, width = gray.shape
    return np.asarray(cv2.resize(gray, (max(width // 2, 1), max(height // 2, 1)), interpolation=cv2.INTER_AREA))


def _reduced(gray: Array, width: int) -> Array:
    scale = width / gray.shape[1]
    if scale >= 1:
        return gray
    size = (width, max(1, round(scale * gray.shape[0])))
    return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA))


def _matched(left: Array, right: Array, look: tuple[int, int], smallest: int) -> Array:
    """Return the disparities (H, W) of evened images within `look`, pixels of theirs, NaN where they fail a test."""
    low, high = look
    count = -(-(high - low + 1) // _STEP) * _STEP
    counts = _semi_global(left, right, low, count)
    none = (low - 1) * _STEP
    values: Array = counts.astype(np.float32) / _STEP
    counts[(counts == none) | ~_alike(left, right, values)] = none
    cv2.filterSpeckles(counts, none, smallest, _STEP)
    known = counts != none
    if known.any():
        _forget_bands(known, values)
    values[~known] = np.nan
    return values


def _semi_global(left: Array, right: Array, low: int, count: int) -> Array:
    """Return disparities (H, W) int16 in sixteenths of a pixel; what has no partner on the way back is low - 1."""
    # Beside the image stands gray, or OpenCV drops the columns whose partners could lie outside.
    sides = (0, 0, max(0, low + count), max(0, -low))
    padded = [
        cv2.copyMakeBorder(
            as_counts(image),
            *sides,
            cv2.BORDER_CONSTANT,
            value=(128.0,),
        )
        for image in (left, right)
    ]
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=_SMALL_STEP,
        P2=_LARGE_STEP,
        disp12MaxDiff=1,
        preFilterCap=63,
        uniquenessRatio=_UNIQUE,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )
    counts = matcher.compute(padded[0], padded[1])
    return np.ascontiguousarray(counts[:, sides[2] : sides[2] + left.shape[1]])


def _alike(left: Array, right: Array, disparity: Array) -> Array:
    """Return the mask (H, W) of pixels whose surroundings correlate with what the disparity says is the same."""
    across, down = np.meshgrid(*(np.arange(count, dtype=np.float32) for count in reversed(left.shape)))
    across -= disparity
    there = remap(right, across, down, border=cv2.BORDER_CONSTANT)
    product = cv2.blur(left * there, _SURROUNDINGS)
    powers = cv2.blur(left * left, _SURROUNDINGS) * cv2.blur(there * there, _SURROUNDINGS)
    inside = (across >= 0) & (across <= left.shape[1] - 1)
    return np.asarray(inside & (product > _ALIKE * np.sqrt(np.maximum(powers, 0))))


def _forget_bands(known: Array, disparity: Array) -> None:
    """Take the sides of the left image, which the right one cannot show, out of the mask `known`.

    What is matched there is matched with the band at the other side, wherever that happens to look the same. What is
    joined to enough that lies beside the band stays: a wall that comes nearer from the border on is shown there.
    """
    low, high = np.quantile(disparity[known], _BODY)
    width = known.shape[1]
    if max(0, high) - min(0, low) >= _BANDS * width:
        return
    beside = np.zeros(known.shape, bool)
    beside[:, max(0, int(high)) : width + min(0, int(low))] = True
    patches = _patches(known, disparity)
    known &= np.bincount(patches[known & beside], minlength=known.size)[patches] >= _ENOUGH


def _patches(known: Array, disparity: Array) -> Array:
    """Return for each pixel (H, W) the number of its patch: known neighbours whose disparities hardly differ."""
    from scipy.sparse import coo_array  # here, since importing them takes longer than most commands
    from scipy.sparse.csgraph import connected_components

    number = np.arange(known.size).reshape(known.shape)
    ends: list[tuple[Array, Array]] = []
    for here, there in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        joined = known[here] & known[there] & (np.abs(disparity[here] - disparity[there]) <= _JOINED)
        ends.append((number[here][joined], number[there][joined]))
    rows, columns = (np.concatenate(part) for part in zip(*ends, strict=True))
    graph = coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(known.size, known.size))
    return np.asarray(connected_components(graph, directed=False)[1]).reshape(known.shape)


def _repeated(image: Array, farthest: int) -> Array:
    """Return the mask (H, W) of pixels whose surroundings correlate with others of the row up to so far off."""
    power = cv2.blur(image * image, _SURROUNDINGS)
    even = image / cv2.sqrt(np.maximum(power, np.float32(_NOTHING)))
    repeated = np.zeros(image.shape, bool)
    for shift in range(_SHORTEST, farthest + 1):
        alike = cv2.blur(even[:, shift:] * even[:, :-shift], _SURROUNDINGS) > _ALIKE
        repeated[:, shift:] |= alike
        repeated[:, :-shift] |= alike
    return repeated


def _least(pixels: int) -> float:
    """Return how many matches of a map of so many pixels are enough."""
    return max(_FEWEST, _FEWEST_SHARE * pixels)


def default_range(width: int) -> tuple[int, int]:
    """Return the range of disparities for images without a measured one: 0 to a sixth of their width, pixels."""
    return 0, max(1, round(_DEFAULT_SHARE * width))


def range_in(coarse: CoarseMap, width: int) -> tuple[int, int] | None:
    """Return the smallest and the largest disparity to search for, pixels, with margins; None if the map has none.

    coarse: of a pair whose images are `width` pixels wide; it tells none where nothing is matched but what repeats
    itself. The range is negative where the cameras are toed in, or where left and right are swapped.
    """
    known = coarse.disparities[np.isfinite(coarse.disparities)]
    if not known.size or coarse.periodic:
        return None
    low, high = float(known.min()), float(known.max())
    pixel, span = max(1.0, width / SEARCH_WIDTHS[-1]), high - low
    return floor(low - pixel - _FAR * span) - 1, ceil(high + pixel + _NEAR * span) + 1


@dataclass(frozen=True, eq=False)
class Matches:
    """Features found in both images of a pair, each the other's best match; some are wrong.

    left, right: (N, 2) pixels, column and row. turns: (N,) radians from the left feature's direction to the right
    one's, -π … π, positive clockwise. size: (width, height) of the images. contrast: standard deviation of the gray
    levels in the image that has less, counts. searched: pixels that the images were reduced to.
    """

    left: Array
    right: Array
    turns: Array
    size: tuple[int, int]
    contrast: float
    searched: float = PIXELS

    def __post_init__(self) -> None:
        count = len(self.left)
        object.__setattr__(self, "left", readonly(self.left, (count, 2), "left"))
        object.__setattr__(self, "right", readonly(self.right, (count, 2), "right"))
        object.__setattr__(self, "turns", readonly(self.turns, (count,), "turns"))

    @property
    def coarseness(self) -> float:
        """Side of the pixels that features were searched for in, pixels of the images."""
        return max(1.0, sqrt(self.size[0] * self.size[1] / self.searched))


def match_features(left: Array, right: Array) -> Matches:
    """Return the features two images share. left, right: (H, W) uint8.

    Raises InvalidInput for images of different sizes. Source: Lowe, Distinctive Image Features from Scale-Invariant
    Keypoints, IJCV 2004.
    """
    left, right = require_pair(left, right)
    scale = min(1.0, sqrt(PIXELS / left.size))
    size, contrast = (left.shape[1], left.shape[0]), contrast_of(left, right)
    first, second = _Features(left, scale), _Features(right, scale)
    if not first.count or not second.count:
        return Matches(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), size, contrast)
    likeness = first.descriptors @ second.descriptors.T
    best, best_back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    mutual = np.flatnonzero(best_back[best] == np.arange(first.count))
    partners = best[mutual]
    turns = second.angles[partners] - first.angles[mutual]
    turns = (turns + np.pi) % (2 * np.pi) - np.pi
    return Matches(first.pixels[mutual], second.pixels[partners], turns, size, contrast)


def require_pair(left: Array, right: Array) -> tuple[Array, Array]:
    """Return both images of a pair as (H, W) uint8; raises InvalidInput unless they are, and of one size."""
    left = require_shape(left, (None, None), "left", np.uint8)
    right = require_shape(right, (None, None), "right", np.uint8)
    if left.shape != right.shape:
        sizes = (*left.shape[::-1], *right.shape[::-1])
        raise InvalidInput("the images differ in size: {}x{} and {}x{}".format(*sizes))
    return left, right


def contrast_of(*images: Array) -> float:
    """Return the least standard deviation of the gray levels of images (H, W) uint8, counts."""
    return min(float(np.ravel(cv2.meanStdDev(image)[1])[0]) for image in images)


class _Features:
    """The strongest features of an image: pixels (N, 2), angles (N,) radians and descriptors (N, 128) of length 1."""

    def __init__(self, gray: Array, scale: float) -> None:
        finder = cv2.SIFT.create(nfeatures=_MOST, contrastThreshold=_FEATURE_CONTRAST)
        small = gray if scale == 1 else resized(gray, scale)
        points, descriptors = finder.detectAndCompute(small, np.empty(0, np.uint8))
        self.count = len(points)
        ratio = np.array(gray.shape[::-1]) / small.shape[::-1]
        self.pixels = (np.array([point.pt for point in points]).reshape(-1, 2) + 0.5) * ratio - 0.5
        self.angles = np.radians([point.angle for point in points])
        found = np.zeros((0, 128), np.float32) if descriptors is None else np.asarray(descriptors)
        self.descriptors = found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12)
