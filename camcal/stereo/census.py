"""What differs between the surroundings of two pixels: the census transform, and the cost of every disparity."""

import cv2
import numpy as np

from camcal.arrays import Array

REACH = 2  # pixels around the centre: a window of 5 × 5
BITS = (2 * REACH + 1) ** 2 - 1
UNSEEN = 6  # cost of what the right camera cannot see: a quarter of the bits, as a mediocre match has

_BLOCK = 16  # rows whose costs are counted while they are in the cache


def census(gray: Array) -> Array:
    """Return for every pixel which of its neighbours are darker (H, W), uint32, a bit for each of `BITS`.

    gray: (H, W) uint8, uint16 or float32. Brighter and darker images, and those of another contrast, give the same.
    Source: Zabih and Woodfill, Non-parametric local transforms for computing visual correspondence, ECCV 1994.
    """
    height, width = gray.shape
    around = cv2.copyMakeBorder(gray, REACH, REACH, REACH, REACH, cv2.BORDER_REPLICATE)
    transform = np.zeros((height, width), np.uint32)
    for down in range(2 * REACH + 1):
        for across in range(2 * REACH + 1):
            if (down, across) != (REACH, REACH):
                darker = around[down : down + height, across : across + width] < gray
                np.left_shift(transform, 1, out=transform)
                transform |= darker
    return transform


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
