"""OpenCV's stereo matchers, with the settings of a textbook (slambook2, chapter 5) and with better ones."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np

INVALID = -1  # pixels; what OpenCV writes is below the least disparity, which is 0 here

Matcher = Callable[[np.ndarray, np.ndarray, int], np.ndarray]  # left, right, number of disparities -> pixels, NaN


def block_matching(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    matcher = cv2.StereoBM_create(count, 15)
    matcher.setTextureThreshold(10)
    matcher.setUniquenessRatio(15)
    matcher.setPreFilterCap(31)
    matcher.setSpeckleWindowSize(100)
    matcher.setSpeckleRange(2)
    return pixels(matcher.compute(left, right))


def semi_global(block: int, mode: int, **others: int) -> Matcher:
    """Return the matcher with the penalties that OpenCV recommends for a block size."""

    def matches(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
        return pixels(create(count, block, mode, **others).compute(left, right))

    return matches


def create(count: int, block: int, mode: int, **others: int) -> cv2.StereoSGBM:
    penalty = 8 * block * block
    settings = {"disp12MaxDiff": 1, "preFilterCap": 63, "uniquenessRatio": 10, "speckleWindowSize": 100}
    settings |= {"speckleRange": 2} | others
    return cv2.StereoSGBM_create(0, count, block, penalty, 4 * penalty, mode=mode, **settings)


def padded(matches: Matcher) -> Matcher:
    """Return a matcher that sees the left border repeated, so that the first columns are searched too."""

    def whole(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
        wide = [cv2.copyMakeBorder(image, 0, 0, count, 0, cv2.BORDER_REPLICATE) for image in (left, right)]
        return matches(*wide, count)[:, count:]

    return whole


def filled(matches: Matcher) -> Matcher:
    """Return a matcher whose gaps take the smaller disparity of both sides in the row, and empty rows the nearest."""

    def dense(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
        found = matches(left, right, count)
        sides = np.fmin(last_known(found), last_known(found[:, ::-1])[:, ::-1])
        whole = np.where(np.isfinite(found), found, sides)
        rows = np.flatnonzero(np.isfinite(whole).any(axis=1))
        if not rows.size:
            return whole
        return whole[rows[np.abs(np.arange(len(whole))[:, None] - rows).argmin(axis=1)]]

    return dense


def last_known(disparity: np.ndarray) -> np.ndarray:
    """Return for each pixel (H, W) the last disparity of its row up to it, NaN if there is none."""
    places = np.where(np.isfinite(disparity), np.arange(disparity.shape[1]), 0)
    return np.take_along_axis(disparity, np.maximum.accumulate(places, axis=1), axis=1)


def weighted_least_squares(left: np.ndarray, right: np.ndarray, count: int) -> np.ndarray:
    """Return what OpenCV's tutorial of the disparity filter makes of both maps."""
    matcher = create(count, 3, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    other = cv2.ximgproc.createRightMatcher(matcher)
    smoother = cv2.ximgproc.createDisparityWLSFilter(matcher)
    smoother.setLambda(8000)
    smoother.setSigmaColor(1.5)
    maps = matcher.compute(left, right), other.compute(right, left)
    return pixels(smoother.filter(maps[0], left, disparity_map_right=maps[1]))


def pixels(counts: np.ndarray) -> np.ndarray:
    return np.where(counts > 16 * INVALID, counts, np.nan).astype(np.float32) / 16


THREE_WAY = semi_global(3, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
MATCHERS: Mapping[str, Matcher] = {
    "StereoBM 15": block_matching,
    "SGBM as in slambook2": semi_global(9, cv2.STEREO_SGBM_MODE_SGBM, speckleRange=32),
    "SGBM 5": semi_global(5, cv2.STEREO_SGBM_MODE_SGBM),
    "3WAY 3": THREE_WAY,
    "HH4 3": semi_global(3, cv2.STEREO_SGBM_MODE_HH4),
    "HH 3": semi_global(3, cv2.STEREO_SGBM_MODE_HH),
    "3WAY 3, WLS": weighted_least_squares,
    "3WAY 3, left padded": padded(THREE_WAY),
    "3WAY 3, padded, filled": filled(padded(THREE_WAY)),
    "HH 3, padded, filled": filled(padded(semi_global(3, cv2.STEREO_SGBM_MODE_HH))),
}
