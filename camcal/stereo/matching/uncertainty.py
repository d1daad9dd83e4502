"""How far a disparity may be off, told by what is around it."""

from collections.abc import Mapping
from dataclasses import replace
from math import log

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.filling import Filled
from camcal.stereo.matching.fusion import Fused
from camcal.stereo.matching.gray import GrayPair

Weights = Mapping[Confidence, tuple[float, ...]]

_AROUND = (15, 15)  # pixels over which matches are judged
_CLOSE = (9, 9)  # pixels whose contrast a match rests on
_STEP = np.ones((7, 7), np.uint8)
_BLUR = 0.7  # pixels, so that interpolation between pixels makes no difference of its own

# What keeps logarithms finite: differences, contrasts and steps below these say nothing more.
_LEAST_DIFFERENCE = 0.02  # pixels
_LEAST_CONTRAST = 0.3  # gray levels
_LEAST_STEP = 0.1  # pixels


# How the logarithm of the half-width follows from the evidence: regressed on the 68 % quantile of the errors of pairs
# drawn with known truth, and of four real ones, by benchmarks/disparity_uncertainty.py, which prints these tables.
# fmt: off
OF_TWO_MATCHERS: Weights = {
    Confidence.FILLED: (-0.782, 0.021, -0.022, 0.092, -0.079, -0.541, 0.541, 0, -0.084, 0.423),
    Confidence.SINGLE: (0.394, 0.174, 0.098, 0.092, -0.234, -1.438, 0.89, 0, 0, 0),
    Confidence.APART: (1.206, 0.309, 0.517, 0.413, -0.778, -1.77, 0.372, -0.272, 0, 0),
    Confidence.NEAR: (0.353, 0.26, 0.748, 0.228, -0.45, -1.08, 0.128, 0.089, 0, 0),
    Confidence.AGREED: (-0.031, 0.281, 0.68, 0.113, -0.421, -0.779, 0.113, 0.04, 0, 0),
}
OF_THE_CENSUS: Weights = {
    Confidence.FILLED: (-0.932, 0.201, 0.02, 0.122, -0.171, -0.501, 0.441, -0.106, -0.062, 0.468),
    Confidence.SINGLE: (-0.181, 0.305, 0.762, 0.004, -0.395, -0.471, 0.283, 0.035, 0, 0),
}
OF_A_SINGLE_PASS: Weights = {  # for evidence at a quarter of the size
    Confidence.FILLED: (2.846, 0.063, 0, -0.03, 0.378, -3.147, 0.991, 0, 0.1, -0.315),
    Confidence.SINGLE: (-0.493, 0.118, 0, -0.372, 0.039, -0.548, 0.374, 0, 0.367, 1.625),
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
        np.exp(np.einsum("kw,wk->w", facts, table[classes]), out=row)
    return sigma


def evidence_of(pair: GrayPair, fused: Fused, filled: Filled, smooth: Array) -> Array:
    """Return what speaks for and against each disparity (10, H, W), float32.

    In this order: 1; log of the noise; log of the difference of two answers around the pixel; log of the contrast along
    the row over the noise, and over what the images differ by; share of the pixels around it with a match; log of the
    step of disparity beside it; log of its own difference; log of the choice that filled it; log of how far that was
    fetched. smooth: (H, W) the map, pixels.
    """
    known = np.isfinite(fused.disparity)
    smooth = np.nan_to_num(smooth)  # numbers are missing only where nothing is matched in all of the image
    support = cv2.boxFilter(known.astype(np.float32), cv2.CV_32F, _AROUND)
    differences = np.minimum(np.nan_to_num(fused.difference), 1).astype(np.float32)
    compared = cv2.boxFilter(np.isfinite(fused.difference).astype(np.float32), cv2.CV_32F, _AROUND)
    around = np.sqrt(np.maximum(cv2.boxFilter(differences**2, cv2.CV_32F, _AROUND), 0) / np.maximum(compared, 1e-3))
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
    left, right = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), _BLUR) for image in (pair.left, pair.right))
    off = left - cv2.remap(right, across - disparity, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mean = cv2.boxFilter(off, cv2.CV_32F, _CLOSE)
    return np.asarray(np.sqrt(np.maximum(cv2.boxFilter(off**2, cv2.CV_32F, _CLOSE) - mean**2, 0)))


def reduced(
    pair: GrayPair, fused: Fused, filled: Filled, smooth: Array, factor: int
) -> tuple[GrayPair, Fused, Filled, Array]:
    """Return what evidence is made of at a smaller size, where it takes little time."""
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
