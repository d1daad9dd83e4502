"""Semi-global matching of census transforms with four paths.

The census transform says what differs between the surroundings of two pixels. Everything fits eight bits: a cost of at
most 24, plus a jump of at most 39, gives 63 along a path and 252 for all four.
Source: Hirschmüller, Stereo processing by semiglobal matching and mutual information, PAMI 2008.
"""

import cv2
import numpy as np

from camcal.arrays import Array

STEP = 8  # what a change of disparity by one pixel costs
JUMP = 39  # what a larger one costs where neighbours are similar
_ALIKE = 12.0  # gray levels between neighbours up to which they do

_STRIP = 512  # rows whose paths run side by side: what a step touches stays in the cache, its calls are few
_NEVER = 255
_OWN = 2  # places on either side of the best that belong to it
_UNIQUENESS_MARGIN = 20  # of 252; where texture repeats itself, three of four second best cost less than that more
_AROUND = (9, 9)  # pixels; more are surer on planes, and less sure beside edges

# Of the census transform.
REACH = 2  # pixels around the centre: a window of 5 × 5
BITS = (2 * REACH + 1) ** 2 - 1
UNSEEN = 6  # cost of what the right camera cannot see: a quarter of the bits, as a mediocre match has
_BLOCK = 16  # rows that are worked on while they are in the cache


def smoothness_penalties(guide: Array, axis: int) -> Array:
    """Return what a jump between each pixel (H, W) and the one before it along an axis costs, uint8.

    guide: the left image (H, W), 8 bits. Where its gray levels jump, disparities may.
    """
    change = np.abs(np.diff(guide.astype(np.float32), axis=axis, prepend=np.float32(0)))
    return np.maximum(JUMP / np.maximum(1, change / _ALIKE), STEP + 1).astype(np.uint8)


def aggregate(costs: Array, guide: Array) -> Array:
    """Return the costs (D, H, W), uint8, summed over four paths: from the left, the right, above and below.

    costs: (D, H, W) uint8, at most `census.BITS`. guide: the left image (H, W), 8 bits.
    """
    count, height, width = costs.shape
    total = np.zeros_like(costs)
    _add_both_ways(costs.swapaxes(0, 1), smoothness_penalties(guide, 0), total.swapaxes(0, 1))
    across = smoothness_penalties(guide, 1)
    for top in range(0, height, _STRIP):
        rows = slice(top, top + _STRIP)
        turned = cv2.transpose(costs[:, rows].reshape(-1, width)).reshape(width, count, -1)
        sums = np.zeros_like(turned)
        _add_both_ways(turned, np.ascontiguousarray(across[rows].T), sums)
        total[:, rows] += cv2.transpose(sums.reshape(width, -1)).reshape(count, -1, width)
    return total


def _add_both_ways(costs: Array, jumps: Array, total: Array) -> None:
    """Add to `total` (N, D, W) the costs of the paths along the first axis, there and back.

    costs: (N, D, W). jumps: (N, W), what a jump between n - 1 and n costs. Both directions are taken in one step, since
    a call of numpy costs about as much as what it does.
    """
    length = len(costs)
    paths = np.stack([costs[0], costs[-1]])
    total[0] += paths[0]
    total[-1] += paths[1]
    eased = np.empty_like(paths)
    penalty = np.empty((2, 1, costs.shape[2]), np.uint8)
    for n in range(1, length):
        there, back = n, length - 1 - n
        lowest = paths.min(axis=1, keepdims=True)
        np.add(lowest[0], jumps[there], out=penalty[0])
        np.add(lowest[1], jumps[back + 1], out=penalty[1])
        np.minimum(paths[:, :-2], paths[:, 2:], out=eased[:, 1:-1])
        eased[:, 0], eased[:, -1] = paths[:, 1], paths[:, -2]
        eased += np.uint8(STEP)
        np.minimum(eased, paths, out=eased)
        np.minimum(eased, penalty, out=eased)
        eased -= lowest
        np.add(eased[0], costs[there], out=paths[0])
        np.add(eased[1], costs[back], out=paths[1])
        total[there] += paths[0]
        total[back] += paths[1]


def least(total: Array) -> Array:
    """Return the place along D (H, W) of the least of summed costs (D, H, W), uint8."""
    count, height, width = total.shape
    bits = max(8, (count - 1).bit_length())
    dtype = np.uint16 if bits == 8 else np.uint32
    places = np.arange(count, dtype=dtype)[:, None]
    best = np.empty((height, width), np.int32)
    for y in range(height):
        # Cost and place in one number, of which the least says both: argmin is an order of magnitude slower.
        marked = total[:, y].astype(dtype)
        np.left_shift(marked, bits, out=marked)
        np.bitwise_or(marked, places, out=marked)
        best[y] = marked.min(axis=0)
    best &= (1 << bits) - 1
    return best


def is_ambiguous(total: Array, best: Array) -> Array:
    """Return where (H, W), bool, a place along D at least three from the best (H, W) costs hardly more than it.

    total: summed costs (D, H, W), uint8.
    """
    count, height, width = total.shape
    across = np.arange(width)
    around = np.arange(-_OWN, _OWN + 1)[:, None]
    ambiguous = np.empty((height, width), np.bool_)
    for y in range(height):
        costs = total[:, y].copy()
        lowest = costs[best[y], across].astype(np.int16)
        costs[np.clip(best[y] + around, 0, count - 1), across] = _NEVER
        ambiguous[y] = costs.min(axis=0) - lowest <= _UNIQUENESS_MARGIN
    return ambiguous


def right_costs(total: Array, first: int) -> Array:
    """Return summed costs (D, H, W) of the pixels of the right image, from those of the left one."""
    turned = np.full_like(total, _NEVER)
    for index, costs in enumerate(total):
        here, there = overlap(first + index, total.shape[2])
        turned[index][:, there] = costs[:, here]
    return turned


def fraction(costs: Array, best: Array) -> Array:
    """Return where between two places the least cost (H, W) lies, -0.5 … 0.5, from costs summed over 9 × 9 pixels.

    costs: (D, H, W), before paths were summed: paths pull towards whole numbers. best: (H, W) the place of the least.
    """
    inner = np.clip(best, 1, len(costs) - 2)
    three = np.zeros((3, *best.shape), np.float32)
    for place, plane in enumerate(costs):
        around = cv2.boxFilter(plane, cv2.CV_32F, _AROUND, normalize=False)
        for step, cost in zip((1, 0, -1), three, strict=True):
            np.copyto(cost, around, where=inner == place + step)
    return equiangular_offset(three, inner == best)


def rough_fraction(total: Array, best: Array) -> Array:
    """Return where between two places the least of summed costs lies, quickly; see `fraction`."""
    inner = np.clip(best, 1, len(total) - 2)
    three = np.stack([np.take_along_axis(total, (inner + step)[None], axis=0)[0] for step in (-1, 0, 1)])
    return equiangular_offset(three.astype(np.float32), inner == best)


def equiangular_offset(three: Array, known: Array) -> Array:
    """Return where two lines of equal and opposite slope through three costs (3, H, W) meet; 0 unless `known`.

    A parabola through them would pull towards whole numbers.
    Source: Shimizu and Okutomi, Sub-pixel estimation error cancellation on area-based matching, IJCV 2005.
    """
    before, middle, after = three
    slope = np.maximum(np.maximum(before, after) - middle, 1)
    return np.where(known, np.clip((before - after) / (2 * slope), -0.5, 0.5), np.float32(0))


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
