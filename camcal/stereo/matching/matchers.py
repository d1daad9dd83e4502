"""The two matchers of a pair, the left–right check, their fusion; filling of gaps, and edge-preserving smoothing.

The matchers fail in different places: the census does not mind the light, gray levels do not mind noise. So where they
agree, they are right. Accepted is what both images agree on, and what does not stand alone.

The matcher on gray levels is OpenCV's three-way one, made to match the whole image: alone it leaves out as many columns
at the left border as there are disparities. Of its modes this one has the least error, uses all cores, and holds no
volume of costs.
Source: Facciolo, de Franchis and Meinhardt, MGM: a significantly more global matching for stereovision, BMVC 2015;
Birchfield and Tomasi, A pixel dissimilarity measure that is insensitive to image sampling, PAMI 1998.
"""

from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.preparation import NOISY, GrayPair
from camcal.stereo.matching.semi_global import (
    aggregate,
    census,
    fraction,
    is_ambiguous,
    least,
    matching_costs,
    right_costs,
    rough_fraction,
)

_SPECKLE, _SPECKLE_SHARE = 400, 0.02  # pixels of a patch, and share of a small image, that need no second witness
_BLUR, _NOISY_BLUR = 0.5, 0.8  # pixels: what a lens does not, so that images sampled between pixels are similar

# Of OpenCV's three-way matching.
_BLOCK = 3
_STEP, _JUMP = 8 * _BLOCK**2, 32 * _BLOCK**2
_CAP = 31  # of the slope of gray levels
_SIXTEENTHS = 16  # OpenCV's disparities are whole sixteenths, and their number a multiple of sixteen
_MOST = 2032  # disparities; sixteenths of more do not fit 16 bits

# What OpenCV's sixteenths mean. Its parabolas pull towards whole pixels: more than a quarter of all matches are whole.
# Scenes have no such preference, so a sixteenth stands for its place among all of them (eight pairs, real and drawn).
# fmt: off
_MEANT = np.array([
    0.0, 0.196, 0.292, 0.360, 0.412, 0.454, 0.489, 0.519, 0.539, 0.551, 0.570, 0.600, 0.637, 0.682, 0.739, 0.816,
], np.float32)
# fmt: on

# Of what is accepted.
AGREEMENT = 1.0  # pixels by which the disparities of both images may differ
_REACH = 15  # pixels over which smoothness may carry a disparity into what has no texture
_SMALLEST = 50  # pixels of a patch
_SMOOTH = 1.0  # pixels between neighbours of a patch
_FRACTIONS = 16  # of a pixel, in the whole numbers that patches are found in
_NOTHING = -(1 << 15)
_SAME, _NEAR = 0.25, 1.0  # pixels between two matchers

_OCCLUSION, _SPARE = 2.0, 30  # times the step between its sides, and pixels, up to which a gap may be an occlusion
_PATCH = (13, 13)  # pixels, width and height, over which disparities beside a gap are averaged
_PATCHES = (8, 14, 20)  # pixels from the gap to the middles of three such patches
_COVERED, _BENT, _STEEPEST = 0.5, 0.3, 0.5  # share with a match; pixels off a straight line; pixels per pixel
_WIDER = 10  # pixels by which a gap may be wider than what is hidden, or lies outside the right image
_MEDIAN = 5  # pixels
_BILATERAL, _QUICK_BILATERAL = 9, 5  # pixels
_KEPT_STEP = 1.5  # pixels of disparity that smoothing keeps
_SMOOTHING_REACH = 3.0  # pixels


class Found(NamedTuple):
    """What a matcher found, pixels: the disparity (H, W) of least cost, and what of it both images agree on, else NaN.

    difference: (H, W) how much they differ, NaN where only one of them sees. ambiguous: (H, W) bool, whether another
    disparity costs hardly more, as where texture repeats itself. end: (H, W) int8, -1 where the least cost lies at the
    lower end of the range, 1 at the upper end, else 0.
    """

    least: Array
    believed: Array
    difference: Array
    ambiguous: Array
    end: Array


def by_census(pair: GrayPair, first: int, count: int) -> Found:
    """Return what semi-global matching on census transforms finds; first: the smallest disparity, count: how many."""
    blur = _NOISY_BLUR if pair.noise > NOISY else _BLUR
    left, right = (census(cv2.GaussianBlur(image, (0, 0), blur)) for image in (pair.deep_left, pair.deep_right))
    costs = matching_costs(left, right, first, count)
    total = aggregate(costs, cv2.GaussianBlur(pair.left, (0, 0), blur))
    best = least(total)
    ambiguous, end = is_ambiguous(total, best), _end(best, 0, count - 1)
    seen = (first + best).astype(np.float32) + fraction(costs, best)
    total = right_costs(total, first)
    best = least(total)
    return _checked(seen, (first + best).astype(np.float32) + rough_fraction(total, best), ambiguous, end)


def by_gray_levels(pair: GrayPair, first: int, count: int) -> Found:
    """Return what three-way semi-global matching on gray levels finds; see `by_census`."""
    seen = three_way(pair.left, pair.right, first, count)
    back = three_way_from_the_right(pair.left, pair.right, first, count)
    return _checked(seen, back, np.zeros(seen.shape, np.bool_), _end(seen, first, first + count - 1))


def by_gray_levels_unchecked(pair: GrayPair, first: int, count: int) -> Found:
    """Return what three-way semi-global matching finds from the left image alone, at half the cost.

    Accepted is all but speckles whose counterpart lies inside the right image. There are no differences.
    """
    smallest = min(_SPECKLE, int(_SPECKLE_SHARE * pair.left.size))
    seen = three_way(pair.left, pair.right, first, count, smallest)
    there = np.arange(seen.shape[1], dtype=np.float32) - seen
    nothing = np.float32(np.nan)
    believed = np.where((there > -0.5) & (there < seen.shape[1] - 0.5), seen, nothing)
    differences = np.broadcast_to(nothing, seen.shape)
    return Found(seen, believed, differences, np.zeros(seen.shape, np.bool_), _end(seen, first, first + count - 1))


def _checked(left: Array, right: Array, ambiguous: Array, end: Array) -> Found:
    difference = difference_seen(left, right)
    believed = without_speckles(np.where(difference <= AGREEMENT, left, np.float32(np.nan)))
    return Found(left, believed, difference, ambiguous, end)


def _end(disparity: Array, first: int, last: int) -> Array:
    """Return at which end of a range disparities (H, W) lie: -1, 1, or 0 for neither; int8."""
    return (disparity >= last).astype(np.int8) - (disparity <= first)


def three_way(left: Array, right: Array, first: int, count: int, smallest: int = 0) -> Array:
    """Return the disparity (H, W), float32 pixels, of the left image; NaN where nothing is found.

    left, right: (H, W) uint8. first: the smallest disparity searched for. count: how many. smallest: pixels of a patch
    whose disparities differ by no more than one from neighbour to neighbour; smaller ones are dropped.
    """
    count = -(-count // _SIXTEENTHS) * _SIXTEENTHS
    if count > _MOST:
        raise InvalidInput(f"{count} disparities exceed the {_MOST} of the matcher of OpenCV")
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=count,
        blockSize=_BLOCK,
        P1=_STEP,
        P2=_JUMP,
        disp12MaxDiff=-1,
        preFilterCap=_CAP,
        uniquenessRatio=0,
        speckleWindowSize=smallest,
        speckleRange=1,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    width = left.shape[1]
    # Columns beside the images let every pixel be matched. The right image is moved by the first disparity, so that the
    # search starts at 0: OpenCV's numbers of 16 bits end at 2047 px.
    columns = np.arange(-count, width + _BLOCK)
    wide = [image[:, np.clip(columns - moved, 0, width - 1)] for image, moved in ((left, 0), (right, first))]
    found: Array = matcher.compute(*wide)[:, count : count + width]
    disparity: Array = (first + (found >> 4)) + _MEANT[found & (_SIXTEENTHS - 1)]
    disparity[found < 0] = np.nan
    return disparity


def three_way_from_the_right(left: Array, right: Array, first: int, count: int) -> Array:
    """Return the disparity (H, W), float32 pixels, of the right image; see `three_way`."""
    mirrored = three_way(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]), first, count)
    return mirrored[:, ::-1]


def difference_seen(left: Array, right: Array) -> Array:
    """Return by how much the disparities (H, W) of the right image differ from the left one's, pixels, absolute.

    left, right: (H, W) float32, seen from each image. NaN for what lies outside the right image: it has no witness.
    """
    width = left.shape[1]
    there = np.rint(np.arange(width, dtype=np.float32) - left)
    inside = (there >= 0) & (there < width)  # False where the disparity is NaN
    back = np.take_along_axis(right, np.where(inside, there, 0).astype(np.intp), axis=1)
    return np.where(inside, np.abs(back - left), np.float32(np.nan))


def ordering_holds(disparity: Array) -> Array:
    """Return where nothing to the right of a pixel in the left image stands left of it in the right one (H, W), bool.

    What is out of order is hidden, or seen past something narrow in front of it.
    """
    there = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    leftmost = np.fmin.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    return ~(there > leftmost + AGREEMENT)


def has_texture(gray: Array) -> Array:
    """Return where an image (H, W) uint8 is more than one gray level within 15 pixels (H, W), bool.

    Elsewhere, as in what is overexposed, all disparities match alike, and both images agree on whichever comes first.
    """
    around = np.ones((2 * _REACH + 1, 2 * _REACH + 1), np.uint8)
    return np.asarray(cv2.subtract(cv2.dilate(gray, around), cv2.erode(gray, around)) > 1)


def without_speckles(disparity: Array) -> Array:
    """Return disparities (H, W), pixels, NaN where a smooth patch of them is smaller than 50 pixels."""
    known = np.isfinite(disparity)
    whole = np.where(known, np.rint(np.nan_to_num(disparity) * _FRACTIONS), _NOTHING)
    patches = np.clip(whole, _NOTHING, -_NOTHING - 1).astype(np.int16)
    cv2.filterSpeckles(patches, _NOTHING, _SMALLEST - 1, int(_SMOOTH * _FRACTIONS))
    return np.where(patches == _NOTHING, np.float32(np.nan), disparity)


class Fused(NamedTuple):
    """Disparity (H, W), pixels, NaN where none is accepted; its `Confidence` (H, W), uint8.

    difference: (H, W) pixels between the two answers it rests on, NaN where there are not two. end: (H, W) int8, where
    the least cost lies at an end of the range, see `Found`.
    """

    disparity: Array
    confidence: Array
    difference: Array
    end: Array


def fused(census: Found, gray_levels: Found) -> Fused:
    """Return the fusion of two matchers: their mean where they are near, else the census.

    Where the census fails its check of left and right, gray levels stand in only if it would have said the same: what
    they alone find is often a foreground grown too large. Where the census has a rival, both may be off by a period,
    and count as one.
    """
    first, second = census.believed, gray_levels.believed
    difference = np.abs(first - second)
    near = difference <= _NEAR
    spare = np.where(np.abs(second - census.least) <= _NEAR, second, np.float32(np.nan))
    disparity = np.where(near, (first + second) / 2, np.where(np.isfinite(first), first, spare))
    confidence = np.where(np.isfinite(disparity), Confidence.SINGLE, Confidence.FILLED)
    confidence = np.where(difference > _NEAR, Confidence.APART, confidence)
    confidence = np.where(near, np.where(difference <= _SAME, Confidence.AGREED, Confidence.NEAR), confidence)
    doubtful = census.ambiguous & (confidence > Confidence.SINGLE)
    confidence = np.where(doubtful, Confidence.SINGLE, confidence)
    difference = np.where(doubtful, np.float32(np.nan), difference)
    return Fused(disparity, confidence.astype(np.uint8), difference, census.end)


def textured(fused: Fused, gray: Array) -> Fused:
    """Return what is known where the left image (H, W) uint8 has texture; the rest is to be filled."""
    texture = has_texture(gray)
    if texture.all():
        return fused
    nothing = np.float32(np.nan)
    return Fused(
        np.where(texture, fused.disparity, nothing),
        np.where(texture, fused.confidence, np.uint8(Confidence.FILLED)),
        np.where(texture, fused.difference, nothing),
        np.where(texture, fused.end, np.int8(0)),
    )


def single_matcher(found: Found) -> Fused:
    """Return what a single matcher says; difference: between what the two images say, at most where it has a rival."""
    known = np.isfinite(found.believed).view(np.uint8)
    confidence = Confidence.FILLED + known * np.uint8(Confidence.SINGLE - Confidence.FILLED)
    difference = np.where(found.ambiguous, np.float32(AGREEMENT), found.difference)
    return Fused(found.believed, confidence, difference, found.end)


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
    return np.asarray(cv2.bilateralFilter(without_spikes(disparity), side, _KEPT_STEP, _SMOOTHING_REACH))
