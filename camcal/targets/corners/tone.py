"""The curve that gamma lays over a picture that is blurred already, as one unknown.

T(f; β) = ((1 + β f)^g - 1) / (g β) with g = 1 / 2.2 and T(f; 0) = f. What is between -1 and 1 as light lies in 1 + β f,
β the contrast of the light; other gammas have curves close to those of this one with another β. A parabola would leave
two parts in a hundred of the contrast, which draw corners whose edges lie along the rows of pixels.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

STRONGEST = 0.97  # |β|, beyond which black has no light at all
_GAMMA = np.float32(1 / 2.2)
_NEAR = np.float32(0.01)  # |β| below which the series is as good in single precision
_LEAST = np.float32(0.01)  # of 1 + β f, where the picture's series has run past -1 or 1


@dataclass(frozen=True, eq=False)
class Toned:
    """A picture (N, K) under its curve, and the derivatives (N, K) by the picture and by β."""

    value: Array
    by_picture: Array
    by_tone: Array


def toned(picture: Array, tone: Array) -> Toned:
    """Return pictures (N, K) between -1 and 1 under curves with β = tone (N, 1)."""
    curved = (np.abs(tone) > _NEAR)[:, 0]
    first, second = (_GAMMA - 1) * picture, (_GAMMA - 1) * (_GAMMA - 2) * picture**2
    value = picture * (1 + tone * (first / 2 + tone * second / 6))
    by_picture = 1 + tone * (first + tone * second / 2)
    by_tone = picture * (first / 2 + tone * second / 3)
    if curved.any():
        some, beta = picture[curved], tone[curved]
        light = np.maximum(1 + beta * some, _LEAST)
        slope = light ** (_GAMMA - 1)
        value[curved] = (slope * light - 1) / (_GAMMA * beta)
        by_picture[curved] = slope
        by_tone[curved] = (some * slope - value[curved]) / beta
    return Toned(value, by_picture, by_tone)
