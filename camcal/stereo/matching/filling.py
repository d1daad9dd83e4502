"""Filling of disparity gaps, and edge-preserving smoothing."""

from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array

_OCCLUSION, _SPARE = 2.0, 30  # times the step between its sides, and pixels, up to which a gap may be an occlusion
_PATCH = (13, 13)  # pixels, width and height, over which disparities beside a gap are averaged
_PATCHES = (8, 14, 20)  # pixels from the gap to the middles of three such patches
_COVERED, _BENT, _STEEPEST = 0.5, 0.3, 0.5  # share with a match; pixels off a straight line; pixels per pixel
_WIDER = 10  # pixels by which a gap may be wider than what is hidden, or lies outside the right image
_MEDIAN = 5  # pixels
_BILATERAL, _QUICK_BILATERAL = 9, 5  # pixels
_STEP = 1.5  # pixels of disparity that smoothing keeps
_REACH = 3.0  # pixels


class Filled(NamedTuple):
    """Disparity (H, W), pixels, with the gaps of each row filled; NaN where a row has none.

    choice: (H, W) by how much the two sides of a gap differ, pixels. distance: (H, W) to the side that was taken,
    the nearer one where both were, pixels. Both are 0 where there is no gap.
    """

    disparity: Array
    choice: Array
    distance: Array


def from_the_background(disparity: Array) -> Filled:
    """Return disparities (H, W) with every gap of a row filled from its side that is farther away.

    What one camera does not see lies behind what hides it, and is as wide as the step of disparity beside it: it goes
    on as steeply as what lies beside it, but not in front of the other side. A gap that is much wider is no occlusion
    but a surface without texture: it goes straight from one side to the other. At the ends of a row there is only one
    side.
    """
    gap = np.isnan(disparity)
    fenced = np.zeros((len(gap), gap.shape[1] + 2), np.bool_)
    fenced[:, 1:-1] = gap
    row, edge = np.divmod(np.flatnonzero(fenced[:, 1:] != fenced[:, :-1]), gap.shape[1] + 1)
    row, start, stop = row[::2], edge[::2], edge[1::2]  # the edges of a gap follow each other
    sides = np.stack([disparity[row, np.maximum(start - 1, 0)], disparity[row, np.minimum(stop, gap.shape[1] - 1)]])
    from_right = ~(sides[0] <= sides[1]) & np.isfinite(sides[1])  # whichever side is no number is no side
    lengths = stop - start
    number = np.repeat(np.arange(len(lengths)), lengths)  # of the gap that a pixel lies in
    place = np.arange(len(number)) - (np.cumsum(lengths) - lengths)[number]
    step = np.abs(sides[0] - sides[1])
    values = np.where(from_right, sides[1], sides[0])[number]
    away = np.where(from_right[number], lengths[number] - place, place + 1)
    nearest = np.fmax(*np.where(np.isfinite(sides).all(axis=0), sides, np.inf))
    slope = np.where(
        lengths <= np.where(from_right, sides[1], sides[0]) + _WIDER,
        _slope(disparity, row, np.where(from_right, stop, start - 1), np.where(from_right, 1, -1)),
        np.float32(0),
    )
    values = np.minimum(values - slope[number] * away, nearest[number])
    straight = (lengths > _OCCLUSION * step + _SPARE)[number]  # False where a side is no number
    first, (left, right) = place[straight] + 1, sides[:, number[straight]]
    values[straight] = left + (right - left) * first / (lengths[number[straight]] + 1)
    away[straight] = np.minimum(first, lengths[number[straight]] + 1 - first)
    filled, choice, distance = disparity.astype(np.float32), *np.zeros((2, *gap.shape), np.float32)
    filled[gap], choice[gap], distance[gap] = values, np.nan_to_num(step)[number], away
    return Filled(filled, choice, distance)


def _slope(disparity: Array, row: Array, column: Array, outward: Array) -> Array:
    """Return how much disparities (H, W) change per pixel away from a gap (N,), 0 where they follow no straight line.

    row, column: (N,) of the pixel beside the gap. outward: (N,) 1 where the gap lies to the left of it, else -1.
    """
    known = np.isfinite(disparity)
    share = cv2.boxFilter(known.astype(np.float32), cv2.CV_32F, _PATCH, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(np.where(known, disparity, 0), cv2.CV_32F, _PATCH, borderType=cv2.BORDER_CONSTANT)
    places = [np.clip(column + outward * away, 0, disparity.shape[1] - 1) for away in _PATCHES]
    shares = np.stack([share[row, place] for place in places])
    near, middle, far = np.stack([total[row, place] for place in places]) / np.maximum(shares, _COVERED)
    slope = (far - near) / (_PATCHES[-1] - _PATCHES[0])
    straight = np.abs(near + far - 2 * middle) < _BENT
    return np.where(straight & (shares >= _COVERED).all(axis=0) & (np.abs(slope) < _STEEPEST), slope, np.float32(0))


def everywhere(disparity: Array) -> Array:
    """Return disparities (H, W) with rows that have none taken from the nearest that has; NaN if none has."""
    rows = np.flatnonzero(np.isfinite(disparity).any(axis=1))
    if not rows.size or rows.size == len(disparity):
        return disparity
    places = np.arange(len(disparity))
    after = np.minimum(np.searchsorted(rows, places), rows.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(places - rows[before] < np.abs(rows[after] - places), rows[before], rows[after])
    return disparity[nearest]


def without_spikes(disparity: Array) -> Array:
    """Return a dense map (H, W), float32 pixels, of the medians of 5 × 5 pixels."""
    return np.asarray(cv2.medianBlur(disparity, _MEDIAN))


def smoothed(disparity: Array, *, quick: bool = False) -> Array:
    """Return a dense map (H, W), float32 pixels, without spikes, and smooth between steps.

    quick: from fewer pixels, which is enough for large maps that are smooth already.
    """
    side = _QUICK_BILATERAL if quick else _BILATERAL
    return np.asarray(cv2.bilateralFilter(without_spikes(disparity), side, _STEP, _REACH))
