"""Robust losses ρ(s) of the squared, whitened residual s; ρ(s) = s is least squares."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from camcal.arrays import Array


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
