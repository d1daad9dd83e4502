"""Whether two images are a pair in the order they are said to be in: not swapped, turned, or one image twice."""

import numpy as np

from camcal.arrays import Array
from camcal.stereo.acceptance import LIMITS
from camcal.stereo.pair.alignment import Residual
from camcal.stereo.pair.features import Matches

SWAPPED = "swapped"
IDENTICAL = "identical"
PERIODIC = "periodic"
FINDINGS = {
    SWAPPED: "left and right swapped, or cameras toed in (negative disparities)",
    IDENTICAL: "both images show the same view: is one of them there twice?",
    PERIODIC: "periodic texture: the images match as well a period off and do not tell disparities",
}

_TURN = np.radians(10.0)
_TURNED = 0.5  # share of the features that are turned alike


def finding_of(residual: Residual, farthest: float = 0.0) -> str | None:
    """Return what is wrong with the order of a pair, SWAPPED or IDENTICAL, None if nothing is.

    farthest: disparity of what is infinitely far, pixels; not 0 for cameras whose principal points differ.
    """
    if np.mean(np.abs(residual.disparity) < LIMITS.parallax_px) > LIMITS.alike:
        return IDENTICAL
    if np.mean(residual.disparity < farthest - LIMITS.sideways_px) > LIMITS.wrong_side:
        return SWAPPED
    return None


def turn_of(matches: Matches) -> float:
    """Return by how much the right image is turned against the left one, radians clockwise; 0 below ten degrees."""
    if not len(matches.turns):
        return 0.0
    apart = np.abs(_wrapped(matches.turns[:, None] - matches.turns))
    alike = apart < _TURN
    middle = int(np.argmax(alike.sum(axis=1)))
    turn = float(np.median(matches.turns[middle] + _wrapped(matches.turns[alike[middle]] - matches.turns[middle])))
    return turn if abs(turn) > _TURN and alike[middle].mean() > _TURNED else 0.0


def _wrapped(angles: Array) -> Array:
    return np.asarray((angles + np.pi) % (2 * np.pi) - np.pi)
