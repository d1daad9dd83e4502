"""The disparity map of a rectified pair: values, uncertainty, and confidence class of every pixel."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from camcal.arrays import Float32Array, readonly
from camcal.brief import Brief


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
