"""The disparity map of a rectified pair: values, uncertainty, and confidence class of every pixel.

And the limits: of pairs that can be matched and of maps that can be used.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Float32Array, readonly
from camcal.messages import Message
from camcal.records import Brief


class Confidence(IntEnum):
    """Where the disparity of a pixel comes from, the surest last; the numbers stand in files."""

    NONE = 0
    FILLED = 1  # from the neighbours: no matcher passed the left-right check
    SINGLE = 2  # one matcher passed it
    APART = 3  # both did, more than 1 px apart
    NEAR = 4  # 0.25 to 1 px apart
    AGREED = 5  # within 0.25 px


@dataclass(frozen=True, eq=False)
class Disparity(Brief):
    """Disparity of the left image, column in the left minus column in the right image.

    values: (H, W) float32 pixels, NaN where there is none. sigma: (H, W) float32 pixels, half the width of what holds
    68 % of the errors, NaN where there is no value. confidence: (H, W) uint8, see `Confidence`. searched: smallest and
    largest disparity looked for, pixels. at_ends: shares of the matches that lie at the lower and at the upper
    end of it.
    """

    values: Float32Array
    sigma: Float32Array
    confidence: NDArray[np.uint8]
    searched: tuple[int, int]
    at_ends: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        shape = np.shape(self.values)
        object.__setattr__(self, "values", readonly(self.values, (None, None), "values", np.float32))
        object.__setattr__(self, "sigma", readonly(self.sigma, shape, "sigma", np.float32))
        object.__setattr__(self, "confidence", readonly(self.confidence, shape, "confidence", np.uint8))


class Limits(NamedTuple):
    """What a pair and its map must keep to.

    rows_px: largest amount that rows may be off, pixels; a plane over the image puts so much right. matched: least
    share of the pixels that are matched and not filled. wrong_side: largest share of the features that may stand on the
    wrong side of what is infinitely far, from `sideways_px` pixels on. alike: largest share of the features that may be
    at one place in both images, to `parallax_px` pixels; two real images scatter more, whatever their distance.
    """

    rows_px: float = 5.0
    matched: float = 0.15
    wrong_side: float = 0.95
    sideways_px: float = 0.5
    alike: float = 0.95
    parallax_px: float = 0.25


LIMITS = Limits()


def too_few(matched: float, *, by_rig: bool = False) -> tuple[Message, ...]:
    """Return the failure of a map with such a share of matched pixels, none if they are enough.

    by_rig: the images were rectified by a rig file, so that this and their order may be wrong.
    """
    if matched >= LIMITS.matched:
        return ()
    text = (
        f"{100 * matched:.1f} % of the pixels matched (limit {100 * LIMITS.matched:g} %): check that both images show "
    )
    if by_rig:
        text += "the same scene, that LEFT and RIGHT are not exchanged, that the rig file is theirs, and the --range"
    else:
        text += "the same scene and are rectified, and the --range"
    return (Message("few_matches", text, {"matched": matched, "limit": LIMITS.matched}),)
