"""The disparity of a rectified pair with its uncertainty.

Of large pairs the full range of disparities is searched at reduced size only. At full size the few about what was found
there are enough, so that time and memory do not grow with their number.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import log
from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.opencv import remap
from camcal.raw.tiles import Each, one_by_one
from camcal.stereo.disparity import Confidence, Disparity
from camcal.stereo.matching.matchers import (
    Filled,
    Found,
    Fused,
    by_census,
    by_gray_levels,
    by_gray_levels_unchecked,
    everywhere,
    from_the_background,
    fused,
    ordering_holds,
    single_matcher,
    smoothed,
    textured,
    without_speckles,
    without_spikes,
)
from camcal.stereo.matching.preparation import GrayPair, Masks, Prepared, prepare
from camcal.stereo.matching.semi_global import UNSEEN, aggregate, census, equiangular_offset, least
from camcal.stereo.options import BACKGROUND, BALANCED, BEST, FAST, NOTHING, MatchOptions

Weights = Mapping[Confidence, tuple[float, ...]]

_JUDGED = (15, 15)  # pixels over which matches are judged
_CLOSE = (9, 9)  # pixels whose contrast a match rests on
_STEP = np.ones((7, 7), np.uint8)
_FINEST = 0.7  # pixels, so that interpolation between pixels makes no difference of its own

# What keeps logarithms finite: differences, contrasts and steps below these say nothing more.
_LEAST_DIFFERENCE = 0.02  # pixels
_LEAST_CONTRAST = 0.3  # gray levels
_LEAST_STEP = 0.1  # pixels

# What photographs add to it, in quadrature: of four real pairs 0.62 to 0.74 of the errors are within, whether the
# rounding of their truth is counted as theirs or not. Drawn pairs ask for nothing.
UNMODELLED = 0.09  # pixels


# How the logarithm of the half-width follows from the evidence: regressed on the 68 % quantile of the errors of pairs
# drawn with known truth, and of four real ones, by benchmarks/disparity_uncertainty.py, which prints these tables.
# fmt: off
OF_TWO_MATCHERS: Weights = {
    Confidence.FILLED: (-0.776, 0.253, -0.049, 0.177, -0.069, -0.63, 0.504, 0, -0.092, 0.305),
    Confidence.SINGLE: (0.302, 0.169, 0.062, 0.131, -0.203, -1.4, 0.845, 0, 0, 0),
    Confidence.APART: (1.09, 0.313, 0.439, 0.344, -0.598, -1.74, 0.49, -0.314, 0, 0),
    Confidence.NEAR: (0.112, 0.213, 0.769, 0.272, -0.496, -0.746, 0.117, 0.097, 0, 0),
    Confidence.AGREED: (-0.337, 0.258, 0.585, 0.151, -0.494, -0.539, 0.07, 0.053, 0, 0),
}
OF_THE_CENSUS: Weights = {
    Confidence.FILLED: (-0.475, 0.302, -0.101, 0.171, -0.138, -0.872, 0.462, -0.107, -0.025, 0.197),
    Confidence.SINGLE: (-0.359, 0.352, 0.622, 0.042, -0.476, -0.436, 0.243, 0.034, 0, 0),
}
OF_A_SINGLE_PASS: Weights = {  # for evidence at a quarter of the size
    Confidence.FILLED: (3.21, 0.377, 0, -0.02, 0.478, -3.55, 0.768, 0, 0.108, -0.359),
    Confidence.SINGLE: (-0.455, 0.047, 0, -0.252, -0.092, -0.621, 0.259, 0, 0, 0),
}
# fmt: on

# By how much wider it is for pairs matched from coarse to fine: what the coarse level found is nearly what the fine one
# finds, so that their difference says less than that of two matchers.
FROM_COARSE_TO_FINE: Mapping[Confidence, float] = {
    Confidence.FILLED: 1.6,
    Confidence.SINGLE: 1.5,
    Confidence.APART: 0.9,
    Confidence.NEAR: 1.5,
    Confidence.AGREED: 1.2,
}


def widened(weights: Weights, factors: Mapping[Confidence, float]) -> Weights:
    """Return the weights of half-widths that are larger by a factor for each class."""
    return {each: (row[0] + log(factors[each]), *row[1:]) for each, row in weights.items()}


def standard_deviation(evidence: Array, confidence: Array, weights: Weights) -> Array:
    """Return the half-width (H, W), float32 pixels, that holds 68 % of the errors.

    evidence: (K, H, W), see `evidence_of`. confidence: (H, W) of `Confidence`. weights: for each of them, how the
    logarithm of the half-width follows from the evidence.
    """
    table = np.zeros((len(Confidence), len(evidence)), np.float32)
    for each, row in weights.items():
        table[each] = row
    sigma = np.empty(confidence.shape, np.float32)
    for facts, classes, row in zip(evidence.swapaxes(0, 1), confidence, sigma, strict=True):
        np.hypot(np.exp(np.einsum("kw,wk->w", facts, table[classes])), np.float32(UNMODELLED), out=row)
    return sigma


def evidence_of(pair: GrayPair, fused: Fused, filled: Filled, smooth: Array) -> Array:
    """Return the features of each disparity (10, H, W), float32.

    In this order: 1; log of the noise; log of the difference of two answers around the pixel; log of the contrast along
    the row over the noise, and over what the images differ by; share of the pixels around it with a match; log of the
    step of disparity beside it; log of its own difference; log of the choice that filled it; log of how far that was
    fetched. smooth: (H, W) the map, pixels.
    """
    known = np.isfinite(fused.disparity)
    smooth = np.nan_to_num(smooth)  # numbers are missing only where nothing is matched in all of the image
    support = cv2.boxFilter(known.astype(np.float32), cv2.CV_32F, _JUDGED)
    differences = np.minimum(np.nan_to_num(fused.difference), 1).astype(np.float32)
    compared = cv2.boxFilter(np.isfinite(fused.difference).astype(np.float32), cv2.CV_32F, _JUDGED)
    around = np.sqrt(np.maximum(cv2.boxFilter(differences**2, cv2.CV_32F, _JUDGED), 0) / np.maximum(compared, 1e-3))
    slope = cv2.Sobel(pair.left, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    contrast = np.sqrt(cv2.boxFilter(slope**2, cv2.CV_32F, _CLOSE))
    step = cv2.dilate(smooth, _STEP) - cv2.erode(smooth, _STEP)
    gap = filled.distance > 0
    return np.stack(
        [
            np.ones_like(smooth),
            np.full_like(smooth, np.log(_LEAST_CONTRAST + pair.noise)),
            np.log(_LEAST_DIFFERENCE + around),
            np.log((_LEAST_CONTRAST + contrast) / (_LEAST_CONTRAST + np.float32(pair.noise))),
            np.log((_LEAST_CONTRAST + contrast) / (_LEAST_CONTRAST + _residual(pair, smooth))),
            support,
            np.log(_LEAST_STEP + step),
            np.where(np.isfinite(fused.difference), np.log(_LEAST_DIFFERENCE + np.nan_to_num(fused.difference)), 0),
            np.where(gap, np.log(_LEAST_STEP + filled.choice), 0),
            np.log1p(filled.distance),
        ]
    )


def _residual(pair: GrayPair, disparity: Array) -> Array:
    """Return how much the images differ around each pixel (H, W) where the disparity puts them on each other, RMS.

    Gray levels; differences of brightness as such, and what linear interpolation makes of fine texture, left out.
    """
    height, width = disparity.shape
    across, down = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left, right = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), _FINEST) for image in (pair.left, pair.right))
    off = left - remap(right, across - disparity, down)
    mean = cv2.boxFilter(off, cv2.CV_32F, _CLOSE)
    return np.asarray(np.sqrt(np.maximum(cv2.boxFilter(off**2, cv2.CV_32F, _CLOSE) - mean**2, 0)))


def reduced(
    pair: GrayPair, fused: Fused, filled: Filled, smooth: Array, factor: int
) -> tuple[GrayPair, Fused, Filled, Array]:
    """Return what evidence is made of at a smaller size, where it takes little time."""
    if factor == 1:
        return pair, fused, filled, smooth
    every = slice(None, None, factor)
    left, right = (
        cv2.resize(image, smooth[every, every].shape[::-1], interpolation=cv2.INTER_AREA)
        for image in (pair.left, pair.right)
    )
    return (
        replace(pair, left=left, right=right),
        Fused(*(values[every, every] for values in fused)),
        Filled(*(values[every, every] for values in filled)),
        smooth[every, every] / factor,
    )


_WEIGHTS = {FAST: OF_A_SINGLE_PASS, BALANCED: OF_THE_CENSUS, BEST: OF_TWO_MATCHERS}
# Times smaller: the evidence of the fast quality takes no time, and that of a large pair half of the memory.
_REDUCED, _REDUCED_LARGE = 4, 2
_RIM = np.ones((5, 5), np.uint8)  # the window of the census: beyond the rim there is no texture of the scene
LARGEST = 2_000_000  # pixels; in smaller images more is lost of what is thin than time is won
_MOST_COSTS = 500_000_000  # bytes of one volume; matching holds two and some more
_NEARBY = 5  # disparities on either side of what the coarser level found
_BLUR = 0.5  # pixels
_AROUND = (13, 13)  # pixels over which costs are compared for a fraction
Matcher = Callable[[GrayPair, int, int], Fused]


def match(left: Array, right: Array, options: MatchOptions | None = None, each: Each = one_by_one) -> Disparity:
    """Return the disparity of the left image of a rectified pair.

    left, right: (H, W), (H, W, 3) BGR or (H, W, 4), uint8, uint16 or float32. each: does pieces of work that do not
    depend on one another. Raises InvalidInput for images of different sizes.
    """
    options = options or MatchOptions()
    prepared = prepare(left, right, options.search, align=options.align_rows, expose=options.expose_alike)
    return match_prepared(prepared, options, each)


def match_prepared(prepared: Prepared, options: MatchOptions, each: Each = one_by_one) -> Disparity:
    """Return the disparity of a pair that was made ready; see `match`."""
    estimate = estimated(prepared, options.quality, each)
    confidence = estimate.confidence
    if options.fill == NOTHING:
        keep = confidence > Confidence.FILLED
    else:
        keep = np.isfinite(estimate.filled.disparity if options.fill == BACKGROUND else estimate.dense)
    values, sigma = estimate.dense, estimate.sigma(_weights(prepared, options.quality))
    if not keep.all():
        nothing = np.float32(np.nan)
        values, sigma = np.where(keep, values, nothing), np.where(keep, sigma, nothing)
        confidence = confidence * keep  # Confidence.NONE is 0
    searched = prepared.first, prepared.first + prepared.count - 1
    end = estimate.end[estimate.confidence > Confidence.FILLED]
    at_ends = (float(np.mean(end < 0)), float(np.mean(end > 0))) if end.size else (0.0, 0.0)
    return Disparity(values, sigma, confidence, searched, at_ends)


def within(disparity: Disparity, valid: Masks) -> Disparity:
    """Return a disparity without what lies where rectified images show nothing, or leads there.

    valid: masks (H, W) of the left and the right image. Values that were filled in need the left one only.
    """
    left, right = (cv2.erode(mask.astype(np.uint8), _RIM, borderValue=1) > 0 for mask in valid)
    rows, columns = np.nonzero(left & np.isfinite(disparity.values))
    partners = np.rint(columns - disparity.values[rows, columns]).astype(np.int64)
    filled = disparity.confidence[rows, columns] <= Confidence.FILLED
    inside = (partners >= 0) & (partners < right.shape[1])
    keep = np.zeros(left.shape, bool)
    keep[rows, columns] = filled | (inside & right[rows, np.clip(partners, 0, right.shape[1] - 1)])
    nothing = np.float32(np.nan)
    values, sigma = (np.where(keep, each, nothing) for each in (disparity.values, disparity.sigma))
    return replace(disparity, values=values, sigma=sigma, confidence=disparity.confidence * keep)


def _weights(prepared: Prepared, quality: str) -> Weights:
    weights = _WEIGHTS[quality]
    coarse = quality != FAST and needs_levels(prepared.pair, prepared.count)
    return widened(weights, FROM_COARSE_TO_FINE) if coarse else weights


class Estimate(NamedTuple):
    """A dense map (H, W), pixels, NaN only if nothing at all was matched, and what it rests on.

    end: see `Fused`. evidence: (K, h, w) of every `step`-th pixel of every `step`-th row, see
    `uncertainty.evidence_of`.
    """

    dense: Array
    confidence: Array
    filled: Filled
    end: Array
    evidence: Array
    step: int

    def sigma(self, weights: Weights) -> Array:
        """Return the standard deviation (H, W), pixels."""
        every = slice(None, None, self.step)
        sigma = standard_deviation(self.evidence, self.confidence[every, every], weights)
        if self.step == 1:
            return sigma
        height, width = self.dense.shape
        wide = cv2.resize(sigma, None, fx=self.step, fy=self.step, interpolation=cv2.INTER_NEAREST)
        return np.asarray(wide[:height, :width])


def estimated(prepared: Prepared, quality: str, each: Each = one_by_one) -> Estimate:
    """Return the dense map of a pair and the evidence for its uncertainty."""
    found = textured(_search(prepared, quality, each), prepared.pair.left)
    filled = from_the_background(found.disparity)
    dense = everywhere(filled.disparity)
    large = needs_levels(prepared.pair, prepared.count)
    dense = without_spikes(dense) if quality == FAST else smoothed(dense, quick=large)
    step = _REDUCED if quality == FAST else _REDUCED_LARGE if large else 1
    evidence = evidence_of(*reduced(prepared.pair, found, filled, dense, step))
    return Estimate(dense, found.confidence, filled, found.end, evidence, step)


def _search(prepared: Prepared, quality: str, each: Each) -> Fused:
    pair, first, count = prepared.pair, prepared.first, prepared.count
    if quality == FAST:
        return single_matcher(by_gray_levels_unchecked(pair, first, count))

    def by_both(pair: GrayPair, first: int, count: int) -> Fused:
        found: dict[object, Found] = {}
        each(lambda matcher: found.update({matcher: matcher(pair, first, count)}), (by_census, by_gray_levels))
        return fused(found[by_census], found[by_gray_levels])

    def by_one(pair: GrayPair, first: int, count: int) -> Fused:
        return single_matcher(by_census(pair, first, count))

    return coarse_to_fine(pair, first, count, by_both if quality == BEST else by_one)


def coarse_to_fine(pair: GrayPair, first: int, count: int, match: Matcher) -> Fused:
    """Return what a matcher finds of a pair, if it is large by way of the pair at half its size.

    first: the smallest disparity searched for, pixels. count: how many.
    """
    if not needs_levels(pair, count):
        return match(pair, first, count)
    half = coarse_to_fine(_halve_pair(pair), first // 2, -(-count // 2) + 1, match)
    return _finer(pair, half)


def needs_levels(pair: GrayPair, count: int) -> bool:
    """Return whether a pair is better matched from coarse to fine."""
    return pair.left.size > LARGEST or pair.left.size * count > _MOST_COSTS


def _halve_pair(pair: GrayPair) -> GrayPair:
    """Return a pair at half its size, rounded up: each pixel the mean of four."""
    return GrayPair(
        _halve_image(pair.left),
        _halve_image(pair.right),
        _halve_image(pair.deep_left),
        _halve_image(pair.deep_right),
        noise=pair.noise / 2,  # the mean of four is half as noisy
    )


def _halve_image(image: Array) -> Array:
    height, width = image.shape
    even = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return np.asarray(cv2.resize(even, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def _finer(pair: GrayPair, half: Fused) -> Fused:
    """Return what is found of a pair about what was found of it at half its size."""
    shape = pair.left.shape
    dense = everywhere(from_the_background(half.disparity).disparity)
    if np.isnan(dense).any():  # in all of it, for nothing is matched
        return Fused(*(_double(values, shape) for values in half))
    near = _double(2 * smoothed(dense, quick=True), shape)
    left, right = (cv2.GaussianBlur(image, (0, 0), _BLUR) for image in (pair.deep_left, pair.deep_right))
    words = census(left)
    whole = np.rint(near).astype(np.int32)
    found = whole - _NEARBY + least(aggregate(_costs_nearby(words, census(right), whole), pair.left))
    smooth = smoothed(smoothed(found.astype(np.float32), quick=True), quick=True)
    disparity = _refine(words, right, smooth)
    confidence = _double(half.confidence, shape)
    believed = (confidence > Confidence.FILLED) & ordering_holds(disparity)
    disparity = without_speckles(np.where(believed, disparity, np.float32(np.nan)))
    confidence = np.where(np.isfinite(disparity), confidence, Confidence.FILLED).astype(np.uint8)
    difference = np.where(np.isfinite(disparity), np.abs(disparity - near), np.float32(np.nan))
    return Fused(disparity, confidence, difference, _double(half.end, shape))


def _double(values: Array, shape: tuple[int, ...]) -> Array:
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


def _refine(words: Array, right: Array, disparity: Array) -> Array:
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
