"""The picture of a disc under a blur, seen as an ellipse: what a dot of a board looks like, with derivatives.

With d the signed distance to the rim, positive outside, κ the rim's curvature and s the blur the picture is
    E[Φ(-d / s - b(ε))],   b(ε) = (1 - √(1 - κ² s² ε²)) / (κ s) = ½ κ s ε² + ⅛ κ³ s³ ε⁴ + …,
Φ the normal distribution and ε a normal number, the blur along the rim, which carries a sample of a round disc out of
it. The mean is taken at ε = 0 and ± √3 (the Gauss-Hermite rule of three points). The picture is the same on opposite
sides of the centre, so that what it leaves out, the rim's change of curvature, does not move that.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from camcal.arrays import Array

_DENSITY = np.float32(1 / np.sqrt(2 * np.pi))
_TINY = np.float32(1e-6)  # so that the centre itself has a direction
_STEPS = 3  # good to 1e-5 of the long axis where the short one is half as long, to 5e-5 at a seventh
_NEAR, _FAR = np.float32(2 / 3), np.float32(1 / 3)  # weights of ε = 0 and of ε² = 3
_FIRST, _THIRD = np.float32(3 / 2), np.float32(9 / 8)  # the terms of b for ε² = 3


@dataclass(frozen=True, eq=False)
class Rim:
    """Where samples (N, K) lie to the rims of N ellipses, pixels.

    distance: positive outside. curvature: 1 / px, of the rim nearby. outward: (N, 2, K) unit normals. unit: (N, 2, K)
    the points of the unit circle that the axes take to the rim nearby.
    """

    distance: Array
    curvature: Array
    outward: Array
    unit: Array


@dataclass(frozen=True, eq=False)
class Picture:
    """The picture (N, K), 1 inside and 0 outside, and its derivatives by the distance and by the blur, per pixel."""

    value: Array
    by_distance: Array
    by_blur: Array


def rim(x: Array, y: Array, axes: Array) -> Rim:
    """Return where samples lie, x, y (N, K) from the ellipses' centres; axes (N, 2, 2) symmetric."""
    lengths, frames = (part.astype(x.dtype) for part in np.linalg.eigh(axes))
    long, short = lengths[:, [1]], lengths[:, [0]]
    (long_x, long_y), (short_x, short_y) = (frames[:, :, k].T[..., None] for k in (1, 0))
    along, across = x * long_x + y * long_y, x * short_x + y * short_y
    cosine, sine = _nearest(np.abs(along), np.abs(across), long, short)
    cosine, sine = np.copysign(cosine, along), np.copysign(sine, across)
    steepness = _length(cosine / long, sine / short)
    normal_along, normal_across = cosine / (long * steepness), sine / (short * steepness)
    distance = (along - long * cosine) * normal_along + (across - short * sine) * normal_across
    return Rim(
        distance,
        1 / ((long * short) ** 2 * (steepness * steepness * steepness)),
        np.stack([normal_along * long_x + normal_across * short_x, normal_along * long_y + normal_across * short_y], 1),
        np.stack([cosine * long_x + sine * short_x, cosine * long_y + sine * short_y], axis=1),
    )


def _nearest(along: Array, across: Array, long: Array, short: Array) -> tuple[Array, Array]:
    """Return cosine and sine (N, K) of the points of ellipses nearest to samples in their first quadrant.

    By steps on the circle that osculates the ellipse at the last point, from the middle of its quadrant.
    """
    cosine = sine = np.full_like(along, np.sqrt(0.5))
    middle_along, middle_across = (long**2 - short**2) / long, (short**2 - long**2) / short
    for _ in range(_STEPS):
        cube_along, cube_across = middle_along * (cosine * cosine * cosine), middle_across * (sine * sine * sine)
        radius = _length(long * cosine - cube_along, short * sine - cube_across)
        off_along, off_across = along - cube_along, across - cube_across
        scale = radius / (_length(off_along, off_across) + _TINY)
        cosine = np.maximum(off_along * scale + cube_along, 0) / long
        sine = np.maximum(off_across * scale + cube_across, 0) / short
        cosine, sine = _normalised(cosine, sine)
    return cosine, sine


def _normalised(x: Array, y: Array) -> tuple[Array, Array]:
    x = x + _TINY
    length = _length(x, y)
    return x / length, y / length


def _length(x: Array, y: Array) -> Array:
    return np.asarray(np.sqrt(x * x + y * y))


def picture(distance: Array, curvature: Array, blur: Array) -> Picture:
    """Return the picture at distances (N, K) from rims of curvature (N, K) under blurs (N, 1)."""
    scaled, bend = distance / blur, curvature * blur
    square = bend * bend
    beyond = scaled + bend * (_FIRST + _THIRD * square)
    density, density_beyond = (
        _DENSITY * weight * np.exp(-0.5 * z * z) for weight, z in ((_NEAR, scaled), (_FAR, beyond))
    )
    both = density + density_beyond
    return Picture(
        _NEAR * ndtr(-scaled) + _FAR * ndtr(-beyond),
        -both / blur,
        (scaled * both - density_beyond * bend * (_FIRST + 3 * _THIRD * square)) / blur,
    )
