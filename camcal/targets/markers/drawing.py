"""What is printed of a marker, as a lens shows it: its cells under a Gaussian blur, with derivatives."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from camcal.arrays import Array, readonly

_ROOT_TWO_PI = np.sqrt(2 * np.pi)
_LARGEST_CORRELATION = 0.9


@dataclass(frozen=True, eq=False)
class MarkerDrawing:
    """The cells (n, n) of a marker, black border included: 0 black, 1 white; white all around.

    Its frame has u along the rows and v down the columns, from -1 to 1 between the outer edges of the border.
    """

    ink: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "ink", readonly(self.ink, (None, len(self.ink)), "ink"))

    @property
    def lines(self) -> Array:
        """The places (n + 1,) of the lines between cells, along u as along v."""
        return np.linspace(-1, 1, len(self.ink) + 1)

    @property
    def edges(self) -> tuple[Array, Array]:
        """Starts and ends (E, 2), as u, v, of the sides of cells where black meets white."""
        padded = np.pad(self.ink, 1, constant_values=1.0)
        row, line = np.nonzero(np.diff(padded[1:-1], axis=1))
        upright = np.stack([np.stack([line, row], axis=1), np.stack([line, row + 1], axis=1)])
        line, column = np.nonzero(np.diff(padded[:, 1:-1], axis=0))
        level = np.stack([np.stack([column, line], axis=1), np.stack([column + 1, line], axis=1)])
        starts, ends = self.lines[np.concatenate([upright, level], axis=1)]
        return starts, ends

    def blurred(self, places: Array, gradients: Array, blur: Array | float) -> "Blurred":
        """Return brightness and slopes at places (K, 2), as u, v.

        gradients: (K, 2, 2) of u and of v by x and y, 1/px. blur: standard deviation of the Gaussian, px.
        The drawing is a sum of quadrants, whose corners the blur turns into bivariate normal distributions; for a
        skewed marker those are correlated: two terms of the tetrachoric series (Pearson 1900).
        """
        slopes = np.linalg.norm(gradients, axis=2)
        skew = (gradients[:, 0] * gradients[:, 1]).sum(axis=1) / slopes.prod(axis=1)
        skew = np.clip(skew, -_LARGEST_CORRELATION, _LARGEST_CORRELATION)
        widths = slopes * blur
        # Places along the last axis: sums over the few lines between cells are then sums of long rows.
        across, down = (((places[:, k] - self.lines[:, None]) / widths[:, k]).astype(np.float32) for k in (0, 1))
        jumps = np.diff(np.diff(np.pad(self.ink, 1, constant_values=1.0), axis=0), axis=1).astype(np.float32)
        p, q = (np.exp(-(z**2) / 2) / np.float32(_ROOT_TWO_PI) for z in (across, down))
        yq, yyq, below = down * q, down**2 * q, ndtr(down)
        summed, level, tilted = jumps @ ndtr(across), jumps @ p, jumps @ (across * p)
        curved = jumps @ (across**2 * p)
        half = skew**2 / 2
        value = 1 + _sum(below, summed) + skew * _sum(q, level) + half * _sum(yq, tilted)
        by_u = _sum(below, level) - skew * _sum(q, tilted) + half * _sum(yq, level - curved)
        by_v = _sum(q, summed) - skew * _sum(yq, level) + half * _sum(q - yyq, tilted)
        by_blur = skew * (_sum(q, curved) + _sum(yyq, level)) - _sum(below, tilted) - _sum(yq, summed)
        return Blurred(value, np.stack([by_u, by_v], axis=1) / widths, by_blur)


@dataclass(frozen=True, eq=False)
class Blurred:
    """Brightness (K,) of a drawing, 0 to 1, its derivatives (K, 2) by u and v, and (K,) by the blur's logarithm."""

    value: Array
    slope: Array
    by_blur: Array


def _sum(one: Array, other: Array) -> Array:
    """Return the inner products (K,) of columns (n, K)."""
    return np.asarray(np.einsum("nk,nk->k", one, other))
