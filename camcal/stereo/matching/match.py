"""The disparity of a rectified pair with its uncertainty."""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.raw.planes import Each, one_by_one
from camcal.stereo.disparity import Confidence, Disparity
from camcal.stereo.matching.filling import Filled, everywhere, from_the_background, smoothed, without_spikes
from camcal.stereo.matching.matchers import (
    Found,
    Fused,
    by_census,
    by_gray_levels,
    by_gray_levels_unchecked,
    fused,
    single_matcher,
    textured,
)
from camcal.stereo.matching.preparation import GrayPair, Masks, Prepared, prepare
from camcal.stereo.matching.pyramid import coarse_to_fine, needs_levels
from camcal.stereo.matching.uncertainty import (
    FROM_COARSE_TO_FINE,
    OF_A_SINGLE_PASS,
    OF_THE_CENSUS,
    OF_TWO_MATCHERS,
    Weights,
    evidence_of,
    reduced,
    standard_deviation,
    widened,
)
from camcal.stereo.options import BACKGROUND, BALANCED, BEST, FAST, NOTHING, MatchOptions

_WEIGHTS = {FAST: OF_A_SINGLE_PASS, BALANCED: OF_THE_CENSUS, BEST: OF_TWO_MATCHERS}
# Times smaller: the evidence of the fast quality takes no time, and that of a large pair half of the memory.
_REDUCED, _REDUCED_LARGE = 4, 2
_RIM = np.ones((5, 5), np.uint8)  # the window of the census: beyond the rim there is no texture of the scene


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
    return Disparity(
        values, sigma, confidence, searched, _at_ends(estimate.end[estimate.confidence > Confidence.FILLED])
    )


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


def _at_ends(end: Array) -> tuple[float, float]:
    """Return the shares of -1 and of 1 among matches (N,)."""
    return (float(np.mean(end < 0)), float(np.mean(end > 0))) if end.size else (0.0, 0.0)


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
    found = textured(_found(prepared, quality, each), prepared.pair.left)
    filled = from_the_background(found.disparity)
    dense = everywhere(filled.disparity)
    large = needs_levels(prepared.pair, prepared.count)
    dense = without_spikes(dense) if quality == FAST else smoothed(dense, quick=large)
    step = _REDUCED if quality == FAST else _REDUCED_LARGE if large else 1
    evidence = evidence_of(*reduced(prepared.pair, found, filled, dense, step))
    return Estimate(dense, found.confidence, filled, found.end, evidence, step)


def _found(prepared: Prepared, quality: str, each: Each) -> Fused:
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
