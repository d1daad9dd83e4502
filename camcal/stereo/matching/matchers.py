"""The two matchers of a pair, each with what both of its images agree on.

They fail in different places: the census does not mind the light, gray levels do not mind noise. So where they agree,
they are right.
"""

from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.stereo.matching.census import census, matching_costs
from camcal.stereo.matching.consistency import AGREEMENT, difference_seen, without_specks
from camcal.stereo.matching.gray import GrayPair
from camcal.stereo.matching.semi_global import (
    aggregate,
    fraction,
    has_rival,
    least,
    rough_fraction,
    seen_from_the_right,
)
from camcal.stereo.matching.three_way import three_way, three_way_from_the_right

_NOISY = 7.0  # gray levels; below, more blur loses more detail than noise
_SPECKLE, _SPECKLE_SHARE = 400, 0.02  # pixels of a patch, and share of a small image, that need no second witness
_BLUR, _NOISY_BLUR = 0.5, 0.8  # pixels: what a lens does not, so that images sampled between pixels look alike


class Found(NamedTuple):
    """What a matcher found, pixels: the disparity (H, W) of least cost, and what of it both images agree on, else NaN.

    difference: (H, W) how much they differ, NaN where only one of them sees. rival: (H, W) bool, whether another
    disparity costs hardly more, as where texture repeats itself. end: (H, W) int8, -1 where the least cost lies at the
    lower end of the range, 1 at the upper end, else 0.
    """

    least: Array
    believed: Array
    difference: Array
    rival: Array
    end: Array


def by_census(pair: GrayPair, first: int, count: int) -> Found:
    """Return what semi-global matching on census transforms finds; first: the smallest disparity, count: how many."""
    blur = _NOISY_BLUR if pair.noise > _NOISY else _BLUR
    left, right = (census(cv2.GaussianBlur(image, (0, 0), blur)) for image in (pair.deep_left, pair.deep_right))
    costs = matching_costs(left, right, first, count)
    total = aggregate(costs, cv2.GaussianBlur(pair.left, (0, 0), blur))
    best = least(total)
    rival, end = has_rival(total, best), _end(best, 0, count - 1)
    seen = (first + best).astype(np.float32) + fraction(costs, best)
    total = seen_from_the_right(total, first)
    best = least(total)
    return _checked(seen, (first + best).astype(np.float32) + rough_fraction(total, best), rival, end)


def by_gray_levels(pair: GrayPair, first: int, count: int) -> Found:
    """Return what three-way semi-global matching on gray levels finds; see `by_census`."""
    seen = three_way(pair.left, pair.right, first, count)
    back = three_way_from_the_right(pair.left, pair.right, first, count)
    return _checked(seen, back, np.zeros(seen.shape, np.bool_), _end(seen, first, first + count - 1))


def by_gray_levels_unchecked(pair: GrayPair, first: int, count: int) -> Found:
    """Return what three-way semi-global matching finds from the left image alone, at half the cost.

    Believed is all but speckles whose counterpart lies inside the right image. There are no differences.
    """
    smallest = min(_SPECKLE, int(_SPECKLE_SHARE * pair.left.size))
    seen = three_way(pair.left, pair.right, first, count, smallest)
    there = np.arange(seen.shape[1], dtype=np.float32) - seen
    nothing = np.float32(np.nan)
    believed = np.where((there > -0.5) & (there < seen.shape[1] - 0.5), seen, nothing)
    differences = np.broadcast_to(nothing, seen.shape)
    return Found(seen, believed, differences, np.zeros(seen.shape, np.bool_), _end(seen, first, first + count - 1))


def _checked(left: Array, right: Array, rival: Array, end: Array) -> Found:
    difference = difference_seen(left, right)
    believed = without_specks(np.where(difference <= AGREEMENT, left, np.float32(np.nan)))
    return Found(left, believed, difference, rival, end)


def _end(disparity: Array, first: int, last: int) -> Array:
    """Return at which end of a range disparities (H, W) lie: -1, 1, or 0 for neither; int8."""
    return (disparity >= last).astype(np.int8) - (disparity <= first)
