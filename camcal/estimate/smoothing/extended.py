"""The extended Kalman filter: motion and measurement are any functions, each with its Jacobian beside it.

x_{k+1} = f(x_k, dt) + w, w ~ N(0, Q);  y_k = h(x_k) + n, n ~ N(0, R). Noise that enters elsewhere goes into Q as
G Q Gᵀ. What is measured on a circle or a sphere is compared by `difference`, not by subtraction.
Source: Bar-Shalom, Li, Kirubarajan 2001, section 10.3.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.estimate.smoothing.kalman import Gaussian, Updated, predict, smooth_back, update


@dataclass(frozen=True)
class ExtendedModel:
    """A motion and a measurement of a state (n,), dt in seconds.

    f(x, dt): the next state (n,). F(x, dt): its Jacobian (n, n). Q(x, dt): process noise (n, n). h(x): the expected
    measurement (m,). H(x): its Jacobian (m, n). R: (m, m). difference(y, expected): (m,) their difference as a vector.
    """

    f: Callable[[Array, float], Array]
    F: Callable[[Array, float], Array]
    Q: Callable[[Array, float], Array]
    h: Callable[[Array], Array]
    H: Callable[[Array], Array]
    R: Array
    difference: Callable[[Array, Array], Array] = np.subtract


@dataclass(frozen=True, eq=False)
class ExtendedRun:
    """What a filter knew at each of K stamps, before and after its measurement.

    updates: None where nothing was measured. transitions: (K - 1, n, n) Jacobians of the motion.
    """

    predicted: tuple[Gaussian, ...]
    states: tuple[Gaussian, ...]
    updates: tuple[Updated | None, ...]
    transitions: Array

    @property
    def log_likelihood(self) -> float:
        """The logarithm of the density of all measurements, each given those before it."""
        return sum(step.log_likelihood for step in self.updates if step is not None)


def extended_filter(
    model: ExtendedModel, start: Gaussian, stamps: Array, measurements: Sequence[Array | None]
) -> ExtendedRun:
    """Return what an extended Kalman filter knows at stamps (K,), from the state before the first measurement.

    measurements: K of (m,), None where missing.
    """
    before, predicted, states, updates, transitions = start, [], [], [], []
    for k, measured in enumerate(measurements):
        predicted.append(before)
        step = None if measured is None else _measured(model, before, measured)
        state = before if step is None else step.state
        states.append(state)
        updates.append(step)
        if k < len(measurements) - 1:
            dt = float(stamps[k + 1] - stamps[k])
            F = model.F(state.mean, dt)
            transitions.append(F)
            before = predict(state, F, model.Q(state.mean, dt), model.f(state.mean, dt) - F @ state.mean)
    return ExtendedRun(tuple(predicted), tuple(states), tuple(updates), np.array(transitions))


def extended_smoother(run: ExtendedRun) -> tuple[Gaussian, ...]:
    """Return the K states given all measurements, linear about the filter's. Source: Rauch, Tung, Striebel 1965."""
    smoothed = [run.states[-1]]
    for k in reversed(range(len(run.states) - 1)):
        smoothed.append(smooth_back(run.states[k], run.predicted[k + 1], smoothed[-1], run.transitions[k]))
    return tuple(reversed(smoothed))


def _measured(model: ExtendedModel, before: Gaussian, measured: Array) -> Updated:
    return update(before, model.difference(measured, model.h(before.mean)), model.H(before.mean), model.R)
