"""Uncertainty of disparities, predicted from features of each pixel."""

from collections.abc import Mapping
from dataclasses import replace
from math import log

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.opencv import remap
from camcal.stereo.disparity import Confidence
from camcal.stereo.matching.filling import Filled
from camcal.stereo.matching.matchers import Fused
from camcal.stereo.matching.preparation import GrayPair

Weights = Mapping[Confidence, tuple[float, ...]]

_AROUND = (15, 15)  # pixels over which matches are judged
_CLOSE = (9, 9)  # pixels whose contrast a match rests on
_STEP = np.ones((7, 7), np.uint8)
_BLUR = 0.7  # pixels, so that interpolation between pixels makes no difference of its own

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
