"""Coarse-to-fine matching of large pairs: the full range is searched at reduced size only.

At full size the few about what was found there are enough, so that time and memory do not grow with their number.
"""

from collections.abc import Callable

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.opencv import remap
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.filling import everywhere, from_the_background, smoothed
from camcal.stereo.matching.matchers import Fused, ordering_holds, without_speckles
from camcal.stereo.matching.preparation import GrayPair
from camcal.stereo.matching.semi_global import UNSEEN, aggregate, census, equiangular_offset, least

LARGEST = 2_000_000  # pixels; in smaller images more is lost of what is thin than time is won
_MOST_COSTS = 500_000_000  # bytes of one volume; matching holds two and some more

_NEARBY = 5  # disparities on either side of what the coarser level found
_BLUR = 0.5  # pixels
_AROUND = (13, 13)  # pixels over which costs are compared for a fraction

Matcher = Callable[[GrayPair, int, int], Fused]


def coarse_to_fine(pair: GrayPair, first: int, count: int, match: Matcher) -> Fused:
    """Return what a matcher finds of a pair, if it is large by way of the pair at half its size.

    first: the smallest disparity searched for, pixels. count: how many.
    """
    if not needs_levels(pair, count):
        return match(pair, first, count)
    half = coarse_to_fine(_halved(pair), first // 2, -(-count // 2) + 1, match)
    return _finer(pair, half)


def needs_levels(pair: GrayPair, count: int) -> bool:
    """Return whether a pair is better matched from coarse to fine."""
    return pair.left.size > LARGEST or pair.left.size * count > _MOST_COSTS


def _halved(pair: GrayPair) -> GrayPair:
    """Return a pair at half its size, rounded up: each pixel the mean of four."""
    return GrayPair(
        _half(pair.left),
        _half(pair.right),
        _half(pair.deep_left),
        _half(pair.deep_right),
        noise=pair.noise / 2,  # the mean of four is half as noisy
    )


def _half(image: Array) -> Array:
    height, width = image.shape
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def _finer(pair: GrayPair, half: Fused) -> Fused:
    """Return what is found of a pair about what was found of it at half its size."""
    shape = pair.left.shape
    dense = everywhere(from_the_background(half.disparity).disparity)
    if np.isnan(dense).any():  # in all of it, for nothing is matched
        return Fused(*(_doubled(values, shape) for values in half))
    near = _doubled(2 * smoothed(dense, quick=True), shape)
    left, right = (cv2.GaussianBlur(image, (0, 0), _BLUR) for image in (pair.deep_left, pair.deep_right))
    words = census(left)
    whole = np.rint(near).astype(np.int32)
    found = whole - _NEARBY + least(aggregate(_costs_nearby(words, census(right), whole), pair.left))
    smooth = smoothed(smoothed(found.astype(np.float32), quick=True), quick=True)
    disparity = _refined(words, right, smooth)
    confidence = _doubled(half.confidence, shape)
    believed = (confidence > Confidence.FILLED) & ordering_holds(disparity)
    disparity = without_speckles(np.where(believed, disparity, np.float32(np.nan)))
    confidence = np.where(np.isfinite(disparity), confidence, Confidence.FILLED).astype(np.uint8)
    difference = np.where(np.isfinite(disparity), np.abs(disparity - near), np.float32(np.nan))
    return Fused(disparity, confidence, difference, _doubled(half.end, shape))


def _doubled(values: Array, shape: tuple[int, ...]) -> Array:
    """Return what stands in an image (h, w) in every pixel of one twice as large, of the given shape (H, W)."""
    height, width = shape
    twice = cv2.resize(values, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    return np.ascontiguousarray(twice[:height, :width])


def _costs_nearby(left: Array, right: Array, middle: Array) -> Array:
    """Return the bits (D, H, W), uint8, in which census transforms differ at the disparities about `middle` (H, W)."""
    height, width = left.shape
    costs = np.empty((2 * _NEARBY + 1, height, width), np.uint8)
    across = np.arange(width, dtype=np.intp)
    for y in range(height):
        there = across - middle[y] + _NEARBY - np.arange(len(costs))[:, None]
        words = right[y].take(there, mode="clip")
        words ^= left[y]
        count = np.bitwise_count(words)
        count[(there < 0) | (there >= width)] = UNSEEN
        costs[:, y] = count
    return costs


def _refined(words: Array, right: Array, disparity: Array) -> Array:
    """Return a smooth map (H, W), pixels, moved to where the images agree best, by half a pixel at most.

    words: the census of the left image. The right image is drawn again as the map says, and one pixel to either side.
    """
    height, width = disparity.shape
    across, down = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    costs = np.empty((3, height, width), np.float32)
    for cost, step in zip(costs, (-1, 0, 1), strict=True):
        drawn = remap(right, across - disparity - step, down, cv2.INTER_CUBIC)
        differing = np.bitwise_count(words ^ census(drawn))
        cv2.boxFilter(differing, cv2.CV_32F, _AROUND, dst=cost, normalize=False)
    lowest = (costs[1] <= costs[0]) & (costs[1] <= costs[2])
    return disparity + equiangular_offset(costs, lowest)
