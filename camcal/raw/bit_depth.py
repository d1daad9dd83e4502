"""What counts give away about the bits they have, where a file or an option says more."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.raw.mosaic import Mosaic

_CONTAINERS = frozenset({1023.0, 4095.0, 16383.0, 65535.0})  # white levels that say the type and nothing of the sensor
_SPARE = 4  # times the largest count: two bits that are never used
_FEWEST_BITS = 8
_WIDE = 65535
_NARROWER = (10, 12, 14)
_FEWEST_COUNTS = 8  # different ones, on a grid that chance does not make
_COARSE = 16  # a step whose multiples may be off by one: some writers fill the low bits


class Widened(NamedTuple):
    """Counts of fewer bits that were spread over 16: the bits, and the distance of two of them in the file."""

    bits: int
    step: float

    @property
    def white(self) -> float:
        """The largest count of so many bits."""
        return 2.0**self.bits - 1


def likely_white(peak: float, white: float) -> float | None:
    """Return the white level of so many bits as the largest count takes, None if the stated one may well be right.

    white: counts at saturation as a container of 10 to 16 bits has them; two bits of it are not used.
    """
    if white not in _CONTAINERS or not 0 < peak < (white + 1) / _SPARE:
        return None
    return 2.0 ** max(_FEWEST_BITS, int(peak).bit_length()) - 1


def used_counts(frame: Mosaic) -> Array:
    """Return which of 65536 counts a frame holds, bool; none of them unless its counts are said to have 16 bits."""
    if frame.values.dtype != np.uint16 or frame.white != _WIDE:
        return np.zeros(_WIDE + 1, bool)
    return np.bincount(frame.values.ravel(), minlength=_WIDE + 1) > 0


def widened(used: Iterable[Array]) -> Widened | None:
    """Return how counts of fewer bits became 16, by the counts that frames use; None if they did not.

    They were shifted (12 bits times 16) or scaled to the full range (times 65535 / 4095).
    """
    counts = np.flatnonzero(np.any(list(used), axis=0))
    if len(counts) < _FEWEST_COUNTS:
        return None
    for bits in _NARROWER:
        for step in (2.0 ** (16 - bits), _WIDE / (2.0**bits - 1)):
            off = np.abs(counts - np.rint(np.rint(counts / step) * step))
            if off.max() <= (1 if step >= _COARSE else 0):
                return Widened(bits, step)
    return None
