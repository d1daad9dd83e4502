"""Which disparities to look for in a pair, from the images alone."""

from math import ceil, floor

import numpy as np

from camcal.arrays import Array
from camcal.stereo.pair.coarse import LOOKS, coarse_map

_FAR, _NEAR = 0.04, 0.12  # margins, of the span: what is missed at reduced size is thin and stands in front
_DEFAULT_SHARE = 1 / 6  # of the width


def search_range(left: Array, right: Array) -> tuple[int, int]:
    """Return the smallest and the largest disparity to look for, pixels; `default_range` where the images tell nothing.

    left, right: (H, W) uint8, rows aligned to a few pixels. Raises InvalidInput for images of different sizes.
    """
    return measured_range(left, right) or default_range(left.shape[1])


def default_range(width: int) -> tuple[int, int]:
    """Return the range of disparities for images that do not tell theirs: 0 to a sixth of their width, pixels."""
    return 0, max(1, round(_DEFAULT_SHARE * width))


def measured_range(left: Array, right: Array) -> tuple[int, int] | None:
    """Return the smallest and the largest disparity the images show, pixels, with margins; None if they show none.

    left, right: (H, W) uint8. Negative where the cameras squint, or where left and right are swapped.
    Raises InvalidInput for images of different sizes.
    """
    return range_in(coarse_map(left, right), left.shape[1])


def range_in(disparities: Array, width: int) -> tuple[int, int] | None:
    """Return the range, with margins, of a coarse map of an image that is `width` pixels wide; None if it is empty."""
    known = disparities[np.isfinite(disparities)]
    if not known.size:
        return None
    low, high = float(known.min()), float(known.max())
    pixel, span = max(1.0, width / LOOKS[-1]), high - low
    return floor(low - pixel - _FAR * span) - 1, ceil(high + pixel + _NEAR * span) + 1
