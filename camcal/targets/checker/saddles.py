"""Places in an image where two edges may cross: saddles of its brightness that look the same turned by half a turn.

The determinant of the second derivatives is negative at a saddle whatever its direction, contrast or blur. The second
derivatives have their axes along the middles of the dark and of the bright sectors, even where the edges are not at
right angles: such a saddle knows on which sides of it the dark squares lie.
"""

from dataclasses import dataclass

import numpy as np

from camcal import opencv
from camcal.arrays import Array

SIGMA = 1.2  # px of the Gaussian that derivatives are taken of
APART = 5  # px, the window that one saddle has for itself
LEAST_CONTRAST = 0.7  # gray levels
MOST = 900  # saddles that are looked at, those of most contrast
RING_PX = 3.0
RING = 16  # places on it
SYMMETRY = 0.75  # share of the ring's variance that is the same on opposite sides, 1 at a crossing of straight edges
_TO_CONTRAST = np.pi / 2  # the mixed derivative of erf(x / √2 s) · erf(y / √2 s) is 2 / (π s²)
_OWN_VARIANCE = 0.8  # px², of the derivative filters and of a pixel


@dataclass(frozen=True, eq=False)
class Saddles:
    """N saddles: pixels (N, 2), the direction (N,) of the middle of a dark sector in radians, contrast (N,).

    smooth: (H, W) float32, the image they were found in, blurred by SIGMA.
    """

    pixels: Array
    dark: Array
    contrast: Array
    smooth: Array

    def take(self, rows: Array) -> "Saddles":
        """Return some of the saddles."""
        return Saddles(self.pixels[rows], self.dark[rows], self.contrast[rows], self.smooth)


def find_saddles(gray: Array, sigma: float = SIGMA) -> Saddles:
    """Return the saddles of an image (H, W) uint8 that may be corners of a checker pattern."""
    smooth, xx, xy, yy = opencv.second_derivatives(gray, sigma)
    strength = xy * xy - xx * yy
    floor = (LEAST_CONTRAST / (_TO_CONTRAST * (sigma**2 + _OWN_VARIANCE))) ** 2
    row, column = _peaks(strength, floor)
    xx, xy, yy = (derivative[row, column].astype(np.float64) for derivative in (xx, xy, yy))
    gx = (smooth[row, column + 1] - smooth[row, column - 1]) / 2
    gy = (smooth[row + 1, column] - smooth[row - 1, column]) / 2
    depth = xy * xy - xx * yy
    shift = np.stack([yy * gx - xy * gy, xx * gy - xy * gx], axis=1) / depth[:, None]
    pixels = np.stack([column, row], axis=1) + shift
    saddles = Saddles(
        pixels,
        np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2,  # the image bends downwards from a saddle into the dark
        np.sqrt(depth) * (_TO_CONTRAST * (sigma**2 + _OWN_VARIANCE)),
        smooth,
    )
    return saddles.take((np.abs(shift).max(axis=1, initial=0.0) < 1) & (_symmetry(saddles) > SYMMETRY))


def _peaks(strength: Array, floor: float) -> tuple[Array, Array]:
    """Return rows and columns of the strongest places of their surroundings, the strongest of all if they are many."""
    peak = (strength == opencv.largest_around(strength, APART)) & (strength > floor)
    margin = int(RING_PX) + 1
    peak[:margin], peak[-margin:], peak[:, :margin], peak[:, -margin:] = False, False, False, False
    places = np.flatnonzero(peak)
    if len(places) > MOST:
        places = places[np.argpartition(-strength.ravel()[places], MOST)[:MOST]]
    return np.divmod(places, strength.shape[1])


def _symmetry(saddles: Saddles) -> Array:
    """Return the share (N,) of the brightness on a ring that is the same on opposite sides."""
    angle = np.arange(RING) * (2 * np.pi / RING)
    x, y = saddles.pixels[:, :1], saddles.pixels[:, 1:]
    values = opencv.sampled(saddles.smooth, x + RING_PX * np.cos(angle), y + RING_PX * np.sin(angle))
    values = values - values.mean(axis=1, keepdims=True)
    odd = (values[:, : RING // 2] - values[:, RING // 2 :]) / 2
    return np.asarray(1 - 2 * (odd**2).sum(axis=1) / np.maximum((values**2).sum(axis=1), 1e-9))
