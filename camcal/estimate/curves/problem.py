"""The residuals of a curve as a least-squares problem; the state is the vector of its free parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.curves.curve import Curve, Data, predictions, predictions_with_jacobian
from camcal.solve.losses import Loss
from camcal.solve.steps import Block, Jacobian, Step


@dataclass(frozen=True, eq=False)
class CurveProblem:
    """Predicted minus measured; `free` (L,) indices of the parameters that move, the others stay at `values` (K,).

    low, high: (K,) bounds. loss: of residuals divided by sigma.
    """

    curve: Curve
    data: Data
    values: Array
    free: Array
    low: Array
    high: Array
    loss: Loss | None = None

    @property
    def shared(self) -> int:
        return len(self.free)

    @property
    def groups(self) -> tuple[int, int]:
        return 0, 0

    def full(self, state: Array) -> Array:
        """Return all parameters (K,) at a state (L,)."""
        result = np.array(self.values)
        result[self.free] = state
        return result

    def blocks(self, state: Array) -> Sequence[Block]:
        """Return the one block of residuals; numbers in it are not finite where the curve is not defined."""
        names = [self.curve.parameters[index] for index in self.free]
        predicted, slopes = predictions_with_jacobian(
            self.curve, self.data.columns, self.full(state), len(self.data), names
        )
        target = 0.0 if self.data.target is None else self.data.target[:, None]
        weights = None if self.data.sigma is None else self.data.sigma**-2.0
        with np.errstate(invalid="ignore", over="ignore"):
            residuals = predicted - target
        return [Block(residuals, (Jacobian(slopes, np.arange(self.shared)),), weights=weights, loss=self.loss)]

    def residuals(self, state: Array) -> Array:
        """Return the residuals (N·D,) alone."""
        predicted = predictions(self.curve, self.data.columns, self.full(state), len(self.data))
        return np.asarray(predicted if self.data.target is None else predicted - self.data.target[:, None]).ravel()

    def retract(self, state: Array, step: Step) -> Array:
        """Return the parameters moved by a step; a bound that the step ends at is met exactly."""
        return np.asarray(np.clip(state + step.shared, self.low[self.free], self.high[self.free]))

    def room(self, state: Array) -> tuple[Array, Array]:
        """Return the least and the greatest step that the bounds allow."""
        return self.low[self.free] - state, self.high[self.free] - state

    def rounding(self) -> float:
        """Return the cost of residuals that are rounding errors of the data and nothing else."""
        if self.data.target is None:
            sizes = np.sqrt(np.sum([column**2 for column in self.data.columns.values()], axis=0))
        else:
            sizes = self.data.target
        weighted = sizes if self.data.sigma is None else sizes / self.data.sigma
        return 0.5 * float(np.sum((np.finfo(float).eps * weighted) ** 2))
