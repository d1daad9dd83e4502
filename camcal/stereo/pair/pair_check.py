"""What two images say of themselves as a rectified pair: rows, order, light and range of disparities."""

from dataclasses import dataclass
from math import degrees

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InvalidInput
from camcal.stereo.pair.alignment import LARGEST_CORRECTION, Residual, residual_of
from camcal.stereo.pair.coarse import coarse_map
from camcal.stereo.pair.exposure import Exposure, exposure_of
from camcal.stereo.pair.features import match_features
from camcal.stereo.pair.pair_order import PERIODIC, finding_of, turn_of
from camcal.stereo.pair.search_range import range_in

_TAIL = 0.01


@dataclass(frozen=True, eq=False)
class PairCheck:
    """What was found of a pair.

    finding: SWAPPED, IDENTICAL or PERIODIC of `pair_order`, None for none of them. exposure: None where too little is
    neither black nor white. disparities: (N,) pixels, spread over the left image; empty, and searched None, where too
    little of the images can be matched. searched: the range a search for disparities would take, pixels.
    """

    residual: Residual
    finding: str | None
    exposure: Exposure | None
    disparities: Array
    searched: tuple[int, int] | None

    def __post_init__(self) -> None:
        object.__setattr__(self, "disparities", readonly(self.disparities, (None,), "disparities", np.float32))

    @property
    def disparity(self) -> tuple[float, float]:
        """The range that 98 % of the disparities lie in, pixels."""
        values = self.disparities if self.disparities.size else self.residual.disparity
        low, high = np.quantile(values, [_TAIL, 1 - _TAIL])
        return float(low), float(high)


def check_pair(left: Array, right: Array) -> PairCheck:
    """Return what two images (H, W) uint8 say of themselves as a pair.

    Raises InvalidInput for images of different sizes, or if one is turned against the other; InsufficientData if they
    share too few features.
    """
    matches = match_features(left, right)
    turn = turn_of(matches)
    if turn:
        side = "clockwise" if turn > 0 else "counter-clockwise"
        raise InvalidInput(f"the right image is turned {abs(degrees(turn)):.0f}° {side} against the left; turn it back")
    residual = residual_of(matches)
    coarse = coarse_map(left, right)
    periodic = coarse.periodic and residual.trend.largest <= LARGEST_CORRECTION  # rows far off match by chance
    return PairCheck(
        residual,
        PERIODIC if periodic else finding_of(residual),
        exposure_of(left, right, residual),
        coarse.disparities[np.isfinite(coarse.disparities)],
        range_in(coarse, left.shape[1]),
    )
