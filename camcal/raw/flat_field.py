"""Flat fields: what every pixel makes of even light, as the divisor that undoes it.

Without smoothing the divisor corrects everything that multiplies light: the lens's fall-off, dust, and the response
of single pixels. It then brings in the noise of the flat frame, which is worth it while that is below the 0.5 … 1 %
by which pixels differ: 16 frames at half saturation of a sensor that holds 10 000 electrons have 0.35 %, one has
1.4 %. Smoothing gives up dust and pixels and is for few or noisy frames.
"""

import numpy as np

from camcal.arrays import Array, require_shape
from camcal.errors import InvalidInput
from camcal.raw.mosaic import cell_side, phases

_FLOOR = 1e-3
_SATURATED = 0.95  # of saturation: photon noise clips from about here on, and the mean comes out too low
_MOST_SATURATED = 1e-3  # of the samples: hot pixels are fewer
_DARKEST = 0.02  # mean light of one colour: 80 of 4095 counts, 10 % noise and the error of the black level


def flat_gain(flat: Array, pattern: str, smoothing: float = 0.0) -> Array:
    """Return the divisor (H, W), float32: the flat over the mean of each place of the pattern's cell, at least 1e-3.

    flat: (H, W) linear light, dark frame subtracted, 1 at saturation; best the mean of 16 or more frames.
    smoothing: standard deviation in pixels of a Gaussian over the samples of each place; 0 is none.
    Linear light is divided by it before white balance. The mean of a place is kept, and so is the colour of light.
    Raises InvalidInput if the flat is saturated, almost dark, or not finite.
    """
    flat = require_shape(flat, (None, None), "flat frame", np.float32)
    if not np.isfinite(flat).all():
        raise InvalidInput(f"{np.count_nonzero(~np.isfinite(flat))} pixels of the flat frame are not finite")
    if not 0 <= smoothing < np.inf:
        raise InvalidInput(f"the smoothing of the flat frame is 0 or more pixels, found {smoothing:g}")
    side = cell_side(pattern)
    gain = np.empty_like(flat)
    for place, site in enumerate(phases(pattern)):
        mean = _require_exposed(flat[site], f"row {place // side}, column {place % side} of the {pattern} cell")
        gain[site] = _smooth(flat[site], smoothing / side) / np.float32(mean)
    return np.maximum(gain, _FLOOR, out=gain)


def _require_exposed(samples: Array, place: str) -> float:
    """Return the mean of the samples of one place; raises InvalidInput if they tell no relative light."""
    saturated = np.count_nonzero(samples >= _SATURATED) / samples.size
    if saturated > _MOST_SATURATED:
        where = f"at {place} above {_SATURATED:.0%} of saturation"
        raise InvalidInput(f"the flat frame is saturated: {saturated:.1%} of the samples {where}; expose it for less")
    mean = float(samples.mean(dtype=np.float64))
    if mean < _DARKEST:
        where = f"of saturation at {place}, {_DARKEST:.0%} are needed"
        raise InvalidInput(f"the flat frame is almost dark: mean {mean:.2%} {where}; expose it for longer")
    return mean


def _smooth(samples: Array, sigma: float) -> Array:
    if sigma == 0:
        return samples
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(samples, sigma, mode="reflect"))
