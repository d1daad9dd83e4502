"""The true shape of a simulated board: bow, twist, cubic and stretch, by formulas of their own.

They are written apart from the basis that calibration estimates (targets/surface.py), so that a mistake in one
does not hide in the other. x and y run over [-1, 1] on the points, as drawn; the border follows the formulas.
"""

from dataclasses import astuple, dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.targets.board import Board


@dataclass(frozen=True)
class Shape:
    """How a board differs from its drawing; amplitudes in the board's unit (m, or squares when its size is unknown).

    z = bow_x (1 - x²) + bow_y (1 - y²) + twist x y + cubic (x³ - x), in the board's frame; stretch lengthens x by a
    ratio.
    """

    bow_x: float = 0.0
    bow_y: float = 0.0
    twist: float = 0.0
    cubic: float = 0.0
    stretch: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)).all() or abs(self.stretch) >= 1:
            raise InvalidInput(f"not the shape of a board: {self}; amplitudes are finite, the stretch is below 100 %")

    def __add__(self, other: "Shape") -> "Shape":
        return Shape(
            self.bow_x + other.bow_x,
            self.bow_y + other.bow_y,
            self.twist + other.twist,
            self.cubic + other.cubic,
            self.stretch + other.stretch,
        )

    def apply(self, board: Board, drawn: Array) -> Array:
        """Return where places (..., 2) of the drawing are in the board frame (..., 3), both in the board's unit."""
        half = np.array(board.extent) / 2
        x, y = np.moveaxis((drawn - half) / half, -1, 0)
        height = self.bow_x * (1 - x**2) + self.bow_y * (1 - y**2) + self.twist * x * y + self.cubic * (x**3 - x)
        return np.stack([half[0] + (1 + self.stretch) * half[0] * x, drawn[..., 1], height], axis=-1)

    def points(self, board: Board) -> Array:
        """Return the points (C, 3) of the board as it is, in its unit, in the order of their ids."""
        return self.apply(board, board.points()[:, :2])

    def deflection(self, board: Board) -> float:
        """Return the out-of-plane deflection of the points, peak to peak about their plane, in the board's unit."""
        points = self.points(board)
        plane = np.column_stack([np.ones(len(points)), points[:, :2]])
        return float(np.ptp(points[:, 2] - plane @ np.linalg.lstsq(plane, points[:, 2], rcond=None)[0]))


FLAT = Shape()


def bow(x_m: float, y_m: float) -> Shape:
    """Return a board bent along x and along y by these heights of the middle over the sides."""
    return Shape(bow_x=x_m, bow_y=y_m)


def twist(height_m: float) -> Shape:
    """Return a board whose corners are lifted and lowered in turn by this height."""
    return Shape(twist=height_m)


def cubic(height_m: float) -> Shape:
    """Return a board with an S along x; its largest height is 0.385 of the amplitude x³ - x is multiplied with."""
    return Shape(cubic=height_m)


def stretch(ratio: float) -> Shape:
    """Return a board printed longer along x by this ratio, 0.003 for 0.3 %."""
    return Shape(stretch=ratio)
