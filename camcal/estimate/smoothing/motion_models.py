"""How things move between measurements: random walk, constant velocity, constant acceleration, along one axis.

A state is a position and as many of its derivatives as the model has; noise drives the highest. The continuous form
integrates white noise over the step, so that two steps make the same as one of twice the length, whatever was missed
in between. The discrete form of textbooks holds a random acceleration over each step: it depends on the sampling, has
rank 1, and two steps of it are not one of twice the length.
Source: Bar-Shalom, Li, Kirubarajan 2001, sections 6.2 (continuous) and 6.3 (discrete).
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from camcal.arrays import Array

MODELS = {"rw": ("position",), "cv": ("position", "velocity"), "ca": ("position", "velocity", "acceleration")}
NOISE_FORMS = ("continuous", "discrete")


@dataclass(frozen=True)
class MotionModel:
    """A model of `MODELS` and a form of `NOISE_FORMS`.

    The density q of continuous noise is in m²/s, m²/s³ or m²/s⁵ (rw, cv, ca); of discrete noise q is the variance of
    the step in m², of the acceleration in m²/s⁴, or of the acceleration's change in m²/s⁴.
    """

    name: str = "cv"
    form: str = "continuous"

    @property
    def states(self) -> tuple[str, ...]:
        """The names of what is estimated along an axis, position first."""
        return MODELS[self.name]

    def transition(self, steps: Array) -> Array:
        """Return F (K, n, n) of steps (K,) in seconds: what Taylor makes of the state."""
        size = len(self.states)
        result = np.zeros((len(steps), size, size))
        for row in range(size):
            for column in range(row, size):
                result[:, row, column] = steps ** (column - row) / factorial(column - row)
        return result

    def noise(self, steps: Array) -> Array:
        """Return the covariance (K, n, n) that noise of q = 1 adds in steps (K,) of seconds."""
        return self._held(steps) if self.form == "discrete" else self._integrated(steps)

    def _integrated(self, steps: Array) -> Array:
        """Return ∫ F(τ) e eᵀ F(τ)ᵀ dτ, e the highest derivative."""
        size = len(self.states)
        result = np.zeros((len(steps), size, size))
        for i in range(size):
            for j in range(size):
                power = 2 * size - 1 - i - j
                result[:, i, j] = steps**power / (factorial(size - 1 - i) * factorial(size - 1 - j) * power)
        return result

    def _held(self, steps: Array) -> Array:
        """Return g gᵀ, g what the random number held over a step does to the state."""
        ones = np.ones_like(steps)
        columns = {"rw": (ones,), "cv": (steps**2 / 2, steps), "ca": (steps**2 / 2, steps, ones)}[self.name]
        gain = np.stack(columns, axis=-1)
        return np.asarray(gain[:, :, None] * gain[:, None, :])
