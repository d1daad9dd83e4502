"""The picture of a corner of a checker pattern whose next edges are so near that the blur brings them in.

A row of squares is sgn(u) - sgn(u - h) - sgn(u + h'), so the picture is a sum of nine crossings: of an edge and its two
neighbours with the other edge and its neighbours. At the border of the pattern dark squares end and bright ones do not:
the squares that would be dark beyond it are added as bright ones.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.targets.corners.crossing import crossing, edge

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
