"""Robust losses ρ(s) of the squared, whitened residual s; ρ(s) = s is least squares."""

import math
from statistics import NormalDist
from typing import Protocol

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass


class Loss(Protocol):
    """A loss and its derivative, the weight of iteratively reweighted least squares."""

    def cost(self, squared: Array) -> Array: ...
    def weight(self, squared: Array) -> Array: ...


@dataclass(frozen=True)
class Huber:
    """Quadratic up to `scale`, linear beyond. Source: Huber 1964."""

    scale: float

    def cost(self, squared: Array) -> Array:
        """Return ρ(s) (M,) of squared residuals (M,)."""
        return np.where(squared <= self.scale**2, squared, 2 * self.scale * np.sqrt(squared) - self.scale**2)

    def weight(self, squared: Array) -> Array:
        """Return dρ/ds (M,), at most 1."""
        return self.scale / np.sqrt(np.maximum(squared, self.scale**2))


@dataclass(frozen=True)
class Cauchy:
    """Grows with the logarithm beyond `scale`: gross errors have almost no pull."""

    scale: float

    def cost(self, squared: Array) -> Array:
        """Return ρ(s) (M,) of squared residuals (M,)."""
        return np.asarray(self.scale**2 * np.log1p(squared / self.scale**2))

    def weight(self, squared: Array) -> Array:
        """Return dρ/ds (M,), at most 1."""
        return np.asarray(1 / (1 + squared / self.scale**2))


@dataclass(frozen=True)
class SoftL1:
    """Huber's loss without its corner: quadratic near zero, linear far beyond `scale`."""

    scale: float

    def cost(self, squared: Array) -> Array:
        """Return ρ(s) (M,) of squared residuals (M,)."""
        return np.asarray(2 * self.scale**2 * (np.sqrt(1 + squared / self.scale**2) - 1))

    def weight(self, squared: Array) -> Array:
        """Return dρ/ds (M,), at most 1."""
        return np.asarray(1 / np.sqrt(1 + squared / self.scale**2))


@dataclass(frozen=True)
class Tukey:
    """Constant beyond `scale`: what lies there has no pull at all, so a good start is needed.

    Source: Beaton & Tukey 1974 (the biweight).
    """

    scale: float

    def cost(self, squared: Array) -> Array:
        """Return ρ(s) (M,) of squared residuals (M,)."""
        return np.asarray(self.scale**2 / 3 * (1 - np.maximum(1 - squared / self.scale**2, 0) ** 3))

    def weight(self, squared: Array) -> Array:
        """Return dρ/ds (M,), at most 1."""
        return np.asarray(np.maximum(1 - squared / self.scale**2, 0) ** 2)


def chi_square_beyond(value: float, dof: int) -> float:
    """Return the probability that the sum of `dof` squared standard normal numbers, some tens at most, is more than
    `value`: e^(-value / 2), by which all terms count, would vanish for hundreds of them.

    Its closed form, as SciPy takes longer to import than a small problem to solve.
    Source: Abramowitz and Stegun 1964, 26.4.4 and 26.4.5.
    """
    half = max(value, 0.0) / 2
    odd = dof % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (2 * math.sqrt(half / math.pi) if odd else 1.0)
    for k in range(dof // 2):
        total += term
        term *= half / (k + 1 + odd / 2)
    return total


def student_bound(dof: float) -> float:
    """Return how many estimated standard deviations 95 % of normal errors are within; dof: of the estimate.

    Within 1 % from 3 degrees of freedom on. Source: Abramowitz and Stegun 1964, 26.7.5.
    """
    z = NormalDist().inv_cdf(0.975)
    return (
        z
        + (z**3 + z) / (4 * dof)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * dof**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * dof**3)
    )


def variance_ratio_beyond(value: float, dof: float, dof_below: float) -> float:
    """Return the probability that the ratio of two independent mean squares, of `dof` and `dof_below` degrees of
    freedom, is more than `value`: Fisher's distribution, of one mean square where `dof_below` is infinite.

    Both may be fractions, as those of a sum of squares of several scales. Within 0.002 at 5 % for 3 degrees and more.
    Source: Paulson 1942, after Wilson and Hilferty 1931: the cube root of a mean square is nearly normal.
    """
    above, below, root = 2 / (9 * dof), 2 / (9 * dof_below), math.cbrt(max(value, 0.0))
    return math.erfc(((1 - below) * root - (1 - above)) / math.sqrt(2 * (below * root**2 + above))) / 2
