"""Two maps of disparity made one, and what each pixel of it rests on."""

from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.consistency import AGREEMENT, has_texture
from camcal.stereo.matching.matchers import Found

_SAME, _NEAR = 0.25, 1.0  # pixels between two matchers


class Fused(NamedTuple):
    """Disparity (H, W), pixels, NaN where none is believed; its `Confidence` (H, W), uint8.

    difference: (H, W) pixels between the two answers it rests on, NaN where there are not two. end: (H, W) int8, where
    the least cost lies at an end of the range, see `Found`.
    """

    disparity: Array
    confidence: Array
    difference: Array
    end: Array


def fused(census: Found, gray_levels: Found) -> Fused:
    """Return what two matchers say together: their mean where they are near, else the census.

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
    doubtful = census.rival & (confidence > Confidence.SINGLE)
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


def alone(found: Found) -> Fused:
    """Return what a single matcher says; difference: between what the two images say, at most where it has a rival."""
    known = np.isfinite(found.believed).view(np.uint8)
    confidence = Confidence.FILLED + known * np.uint8(Confidence.SINGLE - Confidence.FILLED)
    difference = np.where(found.rival, np.float32(AGREEMENT), found.difference)
    return Fused(found.believed, confidence, difference, found.end)
