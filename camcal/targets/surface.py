"""The shape of a printed board: a deformation basis in tiers, and the record of what was estimated.

x and y are normalised to [-1, 1] over the bounding box of the points. The out-of-plane terms are Legendre products
without 1, x and y, which a pose can take; the in-plane terms are the ones a camera's scale and skew could be mistaken
for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.brief import Brief
from camcal.targets.board import Board


@dataclass(frozen=True)
class ShapeClass:
    """Terms of a board's shape that have one scale, and what printers and boards do: the prior of that scale.

    median, spread: of a log-normal distribution; scales are standard deviations of a coefficient, for lengths as a
    share of the board's longer side. Half of all boards are taken to have nothing of a class.
    """

    terms: tuple[str, ...]
    median: float
    spread: float


# Scales of the boards of 20 real data sets and two printers; a stretch or shear of 0.1 % moves an edge by 0.05 %.
CLASSES: dict[str, ShapeClass] = {
    "twist": ShapeClass(("xy",), 5e-4, 1.5),
    "bow": ShapeClass(("P2(x)", "P2(y)"), 1e-3, 1.5),
    "cubic": ShapeClass(("P3(x)", "P2(x)y", "xP2(y)", "P3(y)"), 2e-4, 1.5),
    "quartic": ShapeClass(("P4(x)", "P3(x)y", "P2(x)P2(y)", "xP3(y)", "P4(y)"), 1.5e-4, 1.5),
    "stretch": ShapeClass(("x/y scale",), 1e-3, 1.0),
    "shear": ShapeClass(("shear",), 6e-4, 1.0),
    "keystone": ShapeClass(("keystone x", "keystone y"), 1e-4, 0.7),
}
TIERS: dict[str, tuple[str, ...]] = {
    "bow": (*CLASSES["twist"].terms, *CLASSES["bow"].terms),
    **{name: CLASSES[name].terms for name in ("cubic", "quartic")},
    "stretch": (*CLASSES["stretch"].terms, *CLASSES["shear"].terms),
}
OFFSETS = "offsets"
IN_PLANE, OUT_OF_PLANE = "corners in plane", "corners out of plane"
CORNER_CLASSES: dict[str, ShapeClass] = {
    IN_PLANE: ShapeClass((), 1e-4, 0.7),
    OUT_OF_PLANE: ShapeClass((), 1e-4, 1.0),
}
TERMS = tuple(term for found in CLASSES.values() for term in found.terms)
RATIOS = ("x/y scale", "shear")  # terms without a length

_DEGREES: dict[str, tuple[int, int]] = {
    "xy": (1, 1), "P2(x)": (2, 0), "P2(y)": (0, 2),
    "P3(x)": (3, 0), "P2(x)y": (2, 1), "xP2(y)": (1, 2), "P3(y)": (0, 3),
    "P4(x)": (4, 0), "P3(x)y": (3, 1), "P2(x)P2(y)": (2, 2), "xP3(y)": (1, 3), "P4(y)": (0, 4),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Surface(Brief):
    """The estimated shape of a board: coefficients (S,) of named terms and offsets (C, 3) of single points.

    Coefficients and offsets are in the board's unit, those of RATIOS have none.
    covariance: (S, S) of the coefficients. deflection, deflection_std: peak to peak, out of plane.
    tiers: the names of the tiers in use, in the order in which they were found significant.
    classes: scale and its standard deviation by the names of CLASSES and CORNER_CLASSES: shares of the board's longer
    side, ratios for stretch and shear.
    """

    board: Board
    tiers: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(0))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    offsets: FloatArray | None = None
    deflection: float = 0.0
    deflection_std: float = 0.0
    classes: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.terms)
        object.__setattr__(self, "coefficients", readonly(self.coefficients, (count,), "coefficients"))
        object.__setattr__(self, "covariance", readonly(self.covariance, (count, count), "covariance"))
        if self.offsets is not None:
            object.__setattr__(self, "offsets", readonly(self.offsets, (self.board.count, 3), "offsets"))

    @classmethod
    def flat(cls, board: Board) -> "Surface":
        """Return the board as drawn."""
        return cls(board)

    def coefficients_std(self) -> FloatArray:
        """Return the standard deviations (S,) of the coefficients."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def points(self) -> FloatArray:
        """Return the points (C, 3) of the board as it is, in its unit."""
        points = self.board.points() + basis(self.board, self.terms) @ self.coefficients
        return np.asarray(points if self.offsets is None else points + self.offsets)


@lru_cache(maxsize=64)
def basis(board: Board, terms: tuple[str, ...]) -> Array:
    """Return the displacement (C, 3, S) of every point per unit of every term, read-only."""
    centred = board.points()[:, :2] - np.array(board.extent) / 2
    x, y = normalised(board).T
    result = np.zeros((board.count, 3, len(terms)))
    for index, term in enumerate(terms):
        if term == "keystone x":
            result[:, 0, index], result[:, 1, index] = x * x, x * y
        elif term == "keystone y":
            result[:, 0, index], result[:, 1, index] = x * y, y * y
        elif term == "x/y scale":  # mean scale kept: it is the unit of length
            result[:, 0, index], result[:, 1, index] = centred[:, 0] / 2, -centred[:, 1] / 2
        elif term == "shear":
            result[:, 0, index], result[:, 1, index] = centred[:, 1] / 2, centred[:, 0] / 2
        else:
            degree_x, degree_y = _DEGREES[term]
            result[:, 2, index] = _legendre(degree_x, x) * _legendre(degree_y, y)
    result.setflags(write=False)
    return result


def normalised(board: Board) -> Array:
    """Return the places (C, 2) of the points, each coordinate over [-1, 1]."""
    half = np.array(board.extent) / 2
    return np.asarray((board.points()[:, :2] - half) / half)


def _legendre(degree: int, values: Array) -> Array:
    coefficients = np.zeros(degree + 1)
    coefficients[degree] = 1
    return np.asarray(np.polynomial.legendre.legval(values, coefficients))


def scale_unit(board: Board, term: str) -> float:
    """Return what the scale of a term's class is a share of: the board's longer side, 1 for ratios."""
    return 1.0 if term in RATIOS else max(board.extent)
