"""Which disparities to look for in a pair: those of its coarse map, with margins, or a default."""

from math import ceil, floor

import numpy as np

from camcal.stereo.pair.coarse import LOOKS, CoarseMap

_FAR, _NEAR = 0.04, 0.12  # margins, of the span: what is missed at reduced size is thin and stands in front
_DEFAULT_SHARE = 1 / 6  # of the width


def default_range(width: int) -> tuple[int, int]:
    """Return the range of disparities for images that do not tell theirs: 0 to a sixth of their width, pixels."""
    return 0, max(1, round(_DEFAULT_SHARE * width))


def range_in(coarse: CoarseMap, width: int) -> tuple[int, int] | None:
    """Return the smallest and the largest disparity to look for, pixels, with margins; None if the map tells none.

    coarse: of a pair whose images are `width` pixels wide; it tells none where nothing is matched but what repeats
    itself. The range is negative where the cameras are toed in, or where left and right are swapped.
    """
    known = coarse.disparities[np.isfinite(coarse.disparities)]
    if not known.size or coarse.periodic:
        return None
    low, high = float(known.min()), float(known.max())
    pixel, span = max(1.0, width / LOOKS[-1]), high - low
    return floor(low - pixel - _FAR * span) - 1, ceil(high + pixel + _NEAR * span) + 1
