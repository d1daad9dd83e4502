"""How sharp the frames of a video are, and how far things move from one to the next."""

import math

import cv2
import numpy as np

from camcal.arrays import Array

PIXELS = 0.4e6  # of the reduced copies on which frames are compared
_WINDOW = (21, 21)
_LEVELS = 4  # halvings of the copies: things may move by 21 · 2⁴ / 2 pixels of a copy
_RETURN = 0.5  # px of a copy from where a point was to where tracking there and back ends, at most
_FEWEST = 4


def reduced(gray: Array) -> Array:
    """Return a copy (h, w) of an image (H, W) uint8, smaller by the least whole factor that leaves at most PIXELS."""
    factor = math.ceil(math.sqrt(gray.size / PIXELS))
    if factor <= 1:
        return gray
    height, width = (length // factor for length in gray.shape)
    whole = gray[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def focus(copy: Array) -> float:
    """Return the mean squared gradient of a reduced copy (h, w) uint8, gray levels² / px².

    Of frames that show the same thing the sharpest one has most; it says nothing about frames of different things.
    Source: Krotkov, Focusing, International Journal of Computer Vision 1, 1987 (the Tenengrad measure).
    """
    slopes = [cv2.Sobel(copy, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1))]
    return sum(float(cv2.norm(slope, cv2.NORM_L2SQR)) for slope in slopes) / copy.size


def motion(before: Array, after: Array, pixels: Array, scale: float) -> float:
    """Return how far points (N, 2) of a frame have moved since the frame before, median px; infinite if none is met.

    before, after: copies (h, w) uint8 of both frames; scale: pixels of the frame per pixel of a copy.
    Source: Lucas and Kanade 1981 on pyramids; points that do not come back when tracked there and back do not count.
    """
    start = ((pixels + 0.5) / scale - 0.5).astype(np.float32).reshape(-1, 1, 2)
    there, met, _ = cv2.calcOpticalFlowPyrLK(
        after, before, start, np.empty_like(start), winSize=_WINDOW, maxLevel=_LEVELS
    )
    back, met_again, _ = cv2.calcOpticalFlowPyrLK(
        before, after, there, np.empty_like(there), winSize=_WINDOW, maxLevel=_LEVELS
    )
    followed = np.asarray(met).ravel().astype(bool) & np.asarray(met_again).ravel().astype(bool)
    kept = followed & (np.linalg.norm(back - start, axis=-1).ravel() < _RETURN)
    if kept.sum() < _FEWEST:
        return float("inf")
    return float(np.median(np.linalg.norm((there - start)[kept], axis=-1))) * scale
