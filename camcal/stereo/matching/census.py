"""What differs between the surroundings of two pixels: the census transform, and the cost of every disparity."""

import cv2
import numpy as np

from camcal.arrays import Array

REACH = 2  # pixels around the centre: a window of 5 × 5
BITS = (2 * REACH + 1) ** 2 - 1
UNSEEN = 6  # cost of what the right camera cannot see: a quarter of the bits, as a mediocre match has

_BLOCK = 16  # rows that are worked on while they are in the cache


def census(gray: Array) -> Array:
    """Return for every pixel which of its neighbours are darker (H, W), uint32, a bit for each of `BITS`.

    gray: (H, W) uint8, uint16 or float32. Brighter and darker images, and those of another contrast, give the same.
    Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, ECCV 1994.
    """
    around = cv2.copyMakeBorder(gray, REACH, REACH, REACH, REACH, cv2.BORDER_REPLICATE)
    transform = np.zeros(gray.shape, np.uint32)
    for top in range(0, len(gray), _BLOCK):
        _compare(around[top : top + _BLOCK + 2 * REACH], transform[top : top + _BLOCK])
    return transform


def _compare(around: Array, words: Array) -> None:
    """Write into words (H, W) the comparisons of pixels with those around them, (H + 2 REACH, W + 2 REACH)."""
    height, width = words.shape
    middle = around[REACH : REACH + height, REACH : REACH + width]
    for down in range(2 * REACH + 1):
        for across in range(2 * REACH + 1):
            if (down, across) != (REACH, REACH):
                np.left_shift(words, 1, out=words)
                words |= around[down : down + height, across : across + width] < middle


def matching_costs(left: Array, right: Array, first: int, count: int) -> Array:
    """Return the bits (count, H, W), uint8, in which a pixel differs from the one `first`, `first + 1` … to its left.

    left, right: census transforms (H, W) of a rectified pair.
    """
    height, width = left.shape
    costs = np.full((count, height, width), UNSEEN, np.uint8)
    for top in range(0, height, _BLOCK):
        rows = slice(top, top + _BLOCK)
        for index in range(count):
            here, there = overlap(first + index, width)
            np.bitwise_count(left[rows, here] ^ right[rows, there], out=costs[index, rows, here])
    return costs


def overlap(disparity: int, width: int) -> tuple[slice, slice]:
    """Return the columns of the left image that the right one sees at a disparity, and where it sees them."""
    start, stop = min(max(disparity, 0), width), max(min(width, width + disparity), 0)
    start = min(start, stop)
    return slice(start, stop), slice(start - disparity, stop - disparity)
