"""The image model of a blurred checker corner, with derivatives and tone curve.

With d₁, d₂ the signed distances to two edges and s the blur, a crossing resembles  E[sign(d₁ + ε₁) sign(d₂ + ε₂)],
ε normal of standard deviation s and correlated by the cosine ρ of the angle between the edges' normals:
    erf(z₁ / √2) erf(z₂ / √2) + 4 Σ ρᵏ / k! · φ⁽ᵏ⁻¹⁾(z₁) φ⁽ᵏ⁻¹⁾(z₂),   z = d / s,  φ the normal density
(the tetrachoric series, Pearson 1900). It is the same on opposite sides of the corner, so terms left out move nothing.

The next edges may be so near that the blur brings them in. A row of squares is sgn(u) - sgn(u - h) - sgn(u + h'), so
the picture is then a sum of nine crossings: of an edge and its two neighbours with the other edge and its neighbours.
At the border of the pattern dark squares end and bright ones do not: the squares that would be dark beyond it are added
as bright ones.

The curve that gamma lays over what is blurred already is one unknown,
    T(f; β) = ((1 + β f)^g - 1) / (g β)  with g = 1 / 2.2 and T(f; 0) = f.
What is between -1 and 1 as light lies in 1 + β f, β the contrast of the light; other gammas have curves close to those
of this one with another β. A parabola would leave two parts in a hundred of the contrast, which draw corners whose
edges lie along the rows of pixels.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array

_SIGNS = np.array([-1.0, 1.0, -1.0], np.float32)  # of the edge before, the edge itself, the edge after


@dataclass(frozen=True, eq=False)
class CheckerPicture:
    """The picture (N, K), its derivatives by the scaled distances from both edges, and by the logarithms of both blurs
    with a minus sign: the sums of z ∂/∂z over an edge and its neighbours.
    """

    value: Array
    by_first: Array
    by_second: Array
    by_blur_1: Array
    by_blur_2: Array


def alone(first: Array, second: Array, correlation: Array) -> CheckerPicture:
    """Return the picture of two edges at scaled distances (N, K) without neighbours; correlation: see `crossing`."""
    seen = crossing(first, second, correlation)
    return CheckerPicture(seen.value, seen.by_first, seen.by_second, first * seen.by_first, second * seen.by_second)


def crowded(first: Array, second: Array, correlation: Array, border: Array, bright: Array) -> CheckerPicture:
    """Return the picture of two edges and their neighbours.

    first, second: (3, N, K) scaled distances from the edge on the right, the edge itself and the one on the left.
    correlation: see `crossing`. border: (N, 2, 2) whether an edge on the right or left is the border of the pattern.
    bright: (N, 1) the sign of the picture in bright squares.
    """
    seen = [[crossing(one, other, correlation) for other in second] for one in first]
    weights = _Weights.of(border, bright.astype(np.float32))
    sides = [_side(one) for one in first], [_side(other) for other in second]
    value = np.broadcast_to(weights.constant, first[0].shape).copy()
    slopes = [[np.zeros_like(value) for _ in range(3)] for _ in range(2)]
    for i in range(3):
        for j in range(3):
            share = weights.both[:, i, j, None]
            value += share * seen[i][j].value
            slopes[0][i] += share * seen[i][j].by_first
            slopes[1][j] += share * seen[i][j].by_second
    for family in (0, 1):
        for i, (height, slope) in enumerate(sides[family]):
            share = weights.single[:, family, i, None]
            value += share * height
            slopes[family][i] += share * slope
    by_blur = [(places * np.stack(slopes[family])).sum(axis=0) for family, places in enumerate((first, second))]
    return CheckerPicture(value, slopes[0][1], slopes[1][1], *by_blur)


def _side(distance: Array) -> tuple[Array, Array]:
    """Return the picture of one edge at scaled distances (N, K), and its slope."""
    side, density = edge(distance)
    return side, 2 * density


@dataclass(frozen=True, eq=False)
class _Weights:
    """The weights of crossings (N, 3, 3), of single edges (N, 2, 3), and the constant (N, 1)."""

    both: Array
    single: Array
    constant: Array

    @classmethod
    def of(cls, border: Array, bright: Array) -> "_Weights":
        """With c the sign of bright squares and w the other edges' row of squares, a border on the left adds
        c/2 · E[(1 + sgn(u - h)) (1 + c w)], one on the right c/2 · E[(1 - sgn(u + h)) (1 - c w)].
        """
        count = len(border)
        both = np.tile(np.outer(_SIGNS, _SIGNS), (count, 1, 1))
        single, constant = np.zeros((count, 2, 3), np.float32), np.zeros((count, 1), np.float32)
        for family in (0, 1):
            rows = both if family == 0 else both.swapaxes(1, 2)
            for index, sign in ((0, -1), (2, 1)):
                here = border[:, family, index // 2].astype(np.float32)[:, None]
                rows[:, index] += here / 2 * _SIGNS
                single[:, 1 - family] += sign * here / 2 * _SIGNS
                single[:, family, index] += sign * (here * bright / 2)[:, 0]
                constant += here * bright / 2
        return cls(both.astype(np.float32), single, constant)


PIXEL_VARIANCE = 1 / 12  # of a pixel's own square, which blurs every picture
_ROOT_HALF = np.float32(np.sqrt(0.5))
_DENSITY = np.float32(1 / np.sqrt(2 * np.pi))
_HASTINGS = np.array([0.3275911, 0.254829592, -0.284496736, 1.421413741, -1.453152027, 1.061405429], np.float32)
_FAR = np.float32(20.0)
_STRAIGHT = 0.02  # |ρ| below which edges cross at right angles as far as can be seen


@dataclass(frozen=True, eq=False)
class Crossing:
    """The picture (N, K) between -1 and 1, and its derivatives (N, K) by both scaled distances z₁ and z₂."""

    value: Array
    by_first: Array
    by_second: Array


def edge(distance: Array) -> tuple[Array, Array]:
    """Return the picture erf(z / √2) of one edge at scaled distances z, and the normal density at z.

    To 5e-7, which is less than single precision keeps of a gray level, in half the time of scipy.special.erf.
    Source: Abramowitz and Stegun 1964, 7.1.26.
    """
    scaled = np.abs(distance)
    scaled *= _ROOT_HALF
    fall = np.exp(-scaled * scaled)
    scaled *= _HASTINGS[0]
    scaled += 1
    share = np.reciprocal(scaled, out=scaled)
    series = share * _HASTINGS[-1]
    for coefficient in _HASTINGS[-2:0:-1]:
        series += coefficient
        series *= share
    series *= fall
    np.subtract(1, series, out=series)
    fall *= _DENSITY
    return np.copysign(series, distance), fall


def crossing(first: Array, second: Array, correlation: Array) -> Crossing:
    """Return the picture at scaled distances z₁, z₂ (N, K) from the edges of N corners.

    correlation: (N, 1) cosine of the angle between the normals of the two edges.
    """
    (side_1, density_1), (side_2, density_2) = edge(first), edge(second)
    value = side_1 * side_2
    by_first, by_second = 2 * density_1 * side_2, 2 * density_2 * side_1
    if np.abs(correlation).max() < _STRAIGHT:
        return Crossing(value, by_first, by_second)
    both = density_1 * density_2
    first, second = np.clip(first, -_FAR, _FAR), np.clip(second, -_FAR, _FAR)  # where `both` is nought
    bow_1, bow_2 = first * first - 1, second * second - 1
    one, two, three = (4 * correlation**k / divisor for k, divisor in ((1, 1), (2, 2), (3, 6)))
    value += both * (one + two * first * second + three * bow_1 * bow_2)
    by_first += both * (first * (three * (2 - bow_1) * bow_2 - one) - two * second * bow_1)
    by_second += both * (second * (three * (2 - bow_2) * bow_1 - one) - two * first * bow_2)
    return Crossing(value, by_first, by_second)


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
