"""OpenCV's three-way semi-global matcher on gray levels, made to match the whole image.

Alone it leaves out as many columns at the left border as there are disparities. Of its modes this one has the least
error, uses all cores, and holds no volume of costs.
Source: Facciolo, de Franchis and Meinhardt, MGM: a significantly more global matching for stereovision, BMVC 2015;
Birchfield and Tomasi, A pixel dissimilarity measure that is insensitive to image sampling, PAMI 1998.
"""

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput

_BLOCK = 3
_STEP, _JUMP = 8 * _BLOCK**2, 32 * _BLOCK**2
_CAP = 31  # of the slope of gray levels
_FRACTIONS = 16  # OpenCV's disparities are whole sixteenths, and their number a multiple of sixteen

_MOST = 2032  # disparities; sixteenths of more do not fit 16 bits

# What OpenCV's sixteenths mean. Its parabolas pull towards whole pixels: more than a quarter of all matches are whole.
# Scenes have no such preference, so a sixteenth stands for its place among all of them (eight pairs, real and drawn).
# fmt: off
_MEANT = np.array([
    0.0, 0.196, 0.292, 0.360, 0.412, 0.454, 0.489, 0.519, 0.539, 0.551, 0.570, 0.600, 0.637, 0.682, 0.739, 0.816,
], np.float32)
# fmt: on


def three_way(left: Array, right: Array, first: int, count: int, smallest: int = 0) -> Array:
    """Return the disparity (H, W), float32 pixels, of the left image; NaN where nothing is found.

    left, right: (H, W) uint8. first: the smallest disparity looked for. count: how many. smallest: pixels of a patch
    whose disparities differ by no more than one from neighbour to neighbour; smaller ones are dropped.
    """
    count = -(-count // _FRACTIONS) * _FRACTIONS
    if count > _MOST:
        raise InvalidInput(f"{count} disparities are more than the {_MOST} that OpenCV's matcher can tell apart")
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
    disparity: Array = (first + (found >> 4)) + _MEANT[found & (_FRACTIONS - 1)]
    disparity[found < 0] = np.nan
    return disparity


def three_way_from_the_right(left: Array, right: Array, first: int, count: int) -> Array:
    """Return the disparity (H, W), float32 pixels, of the right image; see `three_way`."""
    mirrored = three_way(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]), first, count)
    return mirrored[:, ::-1]
