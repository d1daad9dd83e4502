"""Linear systems measured over time, how they move between measurements, and their Kalman filter and smoother.

x_{k+1} = F_k x_k + u_k + w_k, w_k ~ N(0, Q_k);  y_k = H x_k + n_k, n_k ~ N(0, R_k).
Nothing is known before the first measurement. The filter does not put that as a very large covariance, which costs
digits: it keeps the inverse of the covariance until every state has been observed.

Motion along one axis is a random walk, a constant velocity or a constant acceleration: a state is a position and as
many of its derivatives as the model has; noise drives the highest. The continuous form integrates white noise over the
step, so that two steps make the same as one of twice the length, whatever was missed in between. The discrete form of
textbooks holds a random acceleration over each step: it depends on the sampling, has rank 1, and two steps of it are
not one of twice the length.
Source: Bar-Shalom, Li, Kirubarajan 2001, ch. 5, 6.2 (continuous), 6.3 (discrete), 7.2 (information form), 8.6 (Rauch,
Tung, Striebel).
"""

from functools import cached_property
from itertools import pairwise
from math import factorial

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.estimate.smoothing.kalman import Gaussian, Updated, predict, smooth_back, update

_RANK = 1e-10  # of observed directions, columns scaled to length 1
MODELS = {"rw": ("position",), "cv": ("position", "velocity"), "ca": ("position", "velocity", "acceleration")}
NOISE_FORMS = ("continuous", "discrete")


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """K states of n numbers, and what was measured of them.

    transitions F: (K - 1, n, n). controls u: (K - 1, n). process Q: (K - 1, n, n). linked: (K - 1,) False where the
    next state begins a chain of its own (then F, u and Q mean nothing). observation H: (m, n). measurements: (K, m),
    NaN where missing. noise R: (K, m, m).
    """

    transitions: Array
    controls: Array
    process: Array
    linked: Array
    observation: Array
    measurements: Array
    noise: Array

    def __post_init__(self) -> None:
        numbers, states = np.shape(self.observation)
        steps = len(self.measurements) - 1
        shapes = {
            "transitions": (steps, states, states),
            "controls": (steps, states),
            "process": (steps, states, states),
            "observation": (numbers, states),
            "measurements": (steps + 1, numbers),
            "noise": (steps + 1, numbers, numbers),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        object.__setattr__(self, "linked", readonly(self.linked, (steps,), "linked", bool))

    def __len__(self) -> int:
        return len(self.measurements)

    @cached_property
    def present(self) -> Array:
        """Which numbers were measured, (K, m) bool."""
        return np.isfinite(self.measurements)

    @cached_property
    def chains(self) -> Array:
        """The number of the chain of every state, (K,), from 0."""
        return np.concatenate([[0], np.cumsum(~self.linked)])

    def weighted(self, weights: Array) -> "LinearSystem":
        """Return the system whose measurements count with weights (K,): their covariances divided by them."""
        return replace(self, noise=self.noise / weights[:, None, None])

    def without(self, dropped: Array) -> "LinearSystem":
        """Return the system without some of its measurements, (K,) bool."""
        return replace(self, measurements=np.where(dropped[:, None], np.nan, self.measurements))

    def part(self, states: Array, numbers: Array) -> "LinearSystem":
        """Return the system of some states and measured numbers that the others do not drive, by their indices."""
        square = (slice(None), states[:, None], states)
        return LinearSystem(
            self.transitions[square],
            self.controls[:, states],
            process=self.process[square],
            linked=self.linked,
            observation=self.observation[numbers[:, None], states],
            measurements=self.measurements[:, numbers],
            noise=self.noise[:, numbers[:, None], numbers],
        )

    def unobserved(self) -> dict[int, list[int]]:
        """Return by chain the indices of states that no measurement determines; empty if all is observed.

        A chain is determined if no motion without noise, but for that at rest at 0, leaves all measurements 0.
        """
        found = {}
        starts = [0, *(np.flatnonzero(~self.linked) + 1), len(self)]
        for chain, (first, end) in enumerate(pairwise(starts)):
            null = self._null_space(first, end)
            if null.size:
                found[chain] = [int(state) for state in np.flatnonzero(np.abs(null).max(axis=0) > _RANK)]
        return found

    def _null_space(self, first: int, end: int) -> Array:
        """Return the directions (d, n) of a chain's first state, to scale, that its measurements do not see."""
        size = self.observation.shape[1]
        motion, rows, null = np.eye(size), np.empty((0, size)), np.eye(size)
        for k in range(first, end):
            present = self.present[k]
            if present.any():
                rows = np.vstack([rows, self.observation[present] @ motion])
                scale = np.linalg.norm(rows, axis=0)
                scale = np.where(scale > 0, scale, 1.0)
                _, values, directions = np.linalg.svd(rows / scale)
                rank = int(np.sum(values > _RANK * values[0])) if len(values) else 0
                null = np.asarray(directions[rank:])
                if not null.size:
                    break
            if k + 1 < end:
                motion = self.transitions[k] @ motion
        return null


@dataclass(frozen=True, eq=False)
class Information:
    """What is known of a state that is not yet observed whole: precision (n, n) and precision times mean (n,)."""

    precision: Array
    vector: Array


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the filter knew at each of K stamps, before (None until all is observed) and after its measurement.

    updates: what became of each measurement that was predicted, or None.
    """

    predicted: tuple[Gaussian | None, ...]
    states: tuple[Gaussian | Information, ...]
    updates: tuple[Updated | None, ...]

    @property
    def nis(self) -> Array:
        """Normalised innovations squared (K,), NaN where nothing was predicted."""
        return np.array([np.nan if step is None else step.nis for step in self.updates])

    @property
    def log_likelihood(self) -> float:
        """The logarithm of the density of all measurements that could be predicted."""
        return sum(step.log_likelihood for step in self.updates if step is not None)


def kalman_filter(system: LinearSystem) -> Filtered:
    """Return the state of the forward filter at every stamp."""
    size = system.observation.shape[1]
    nothing = Information(np.zeros((size, size)), np.zeros(size))
    before: Gaussian | Information = nothing
    predicted: list[Gaussian | None] = []
    states: list[Gaussian | Information] = []
    updates: list[Updated | None] = []
    for k in range(len(system)):
        step = None
        predicted.append(before if isinstance(before, Gaussian) else None)
        if isinstance(before, Gaussian):
            step = _measure(before, system, k)
            state: Gaussian | Information = before if step is None else step.state
        else:
            state = _gaussian(_informed(before, system, k))
        states.append(state)
        updates.append(step)
        if k < len(system) - 1:
            before = _next(state, system, k) if system.linked[k] else nothing
    return Filtered(tuple(predicted), tuple(states), tuple(updates))


def rts(system: LinearSystem, filtered: Filtered) -> tuple[Array, Array]:
    """Return the states given all measurements, from what the filter knew: the smoother of Rauch, Tung and Striebel.

    They are means (K, n) and covariances (K, n, n).
    Raises InsufficientData if a state is not observed (`LinearSystem.unobserved` says which).
    """
    smoothed: list[Gaussian] = []
    for k in reversed(range(len(system))):
        state = filtered.states[k]
        ahead = filtered.predicted[k + 1] if k < len(system) - 1 and system.linked[k] else None
        if isinstance(state, Information):
            if k == len(system) - 1 or not system.linked[k]:
                raise InsufficientData(f"state {k} and those before it are not determined by the measurements")
            state = _first_states(state, smoothed[-1], system, k)
        elif ahead is not None:
            state = smooth_back(state, ahead, smoothed[-1], system.transitions[k])
        smoothed.append(state)
    smoothed.reverse()
    return np.array([s.mean for s in smoothed]), np.array([s.covariance for s in smoothed])


def _measure(before: Gaussian, system: LinearSystem, k: int) -> Updated | None:
    present = system.present[k]
    if not present.any():
        return None
    H = system.observation[present]
    return update(
        before, system.measurements[k, present] - H @ before.mean, H, system.noise[k][np.ix_(present, present)]
    )


def _next(state: Gaussian | Information, system: LinearSystem, k: int) -> Gaussian | Information:
    F, Q, u = system.transitions[k], system.process[k], system.controls[k]
    if isinstance(state, Gaussian):
        return predict(state, F, Q, u)
    back = np.linalg.inv(F)  # of a triangle or a rotation
    precision = back.T @ state.precision @ back
    spread = np.linalg.inv(np.eye(len(u)) + precision @ Q)
    return Information(spread @ precision, spread @ (back.T @ state.vector + precision @ u))


def _informed(state: Information, system: LinearSystem, k: int) -> Information:
    present = system.present[k]
    if not present.any():
        return state
    H = system.observation[present]
    weighted = np.linalg.solve(system.noise[k][np.ix_(present, present)], H).T
    return Information(state.precision + weighted @ H, state.vector + weighted @ system.measurements[k, present])


def _gaussian(state: Information) -> Gaussian | Information:
    """Return the state with mean and covariance if it is observed whole."""
    scale = np.sqrt(np.diag(state.precision))
    if not (scale > 0).all():
        return state
    scaled = state.precision / np.outer(scale, scale)
    if np.linalg.eigvalsh(scaled)[0] < _RANK:
        return state
    covariance = np.linalg.inv(scaled) / np.outer(scale, scale)
    return Gaussian(covariance @ state.vector, (covariance + covariance.T) / 2)


def _first_states(state: Information, smoothed: Gaussian, system: LinearSystem, k: int) -> Gaussian:
    """Return a state before all was observed: the motion runs back from the next one, and what was known is added."""
    back = np.linalg.inv(system.transitions[k])
    spread = back @ system.process[k] @ back.T
    keep = np.linalg.inv(np.eye(len(back)) + spread @ state.precision)
    gain, own = keep @ back, keep @ spread
    mean = own @ state.vector + gain @ (smoothed.mean - system.controls[k])
    covariance = own + gain @ smoothed.covariance @ gain.T
    return Gaussian(mean, (covariance + covariance.T) / 2)


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

    def transition(self, steps: Array) -> FloatArray:
        """Return F (K, n, n) of steps (K,) in seconds: what Taylor makes of the state."""
        size = len(self.states)
        result = np.zeros((len(steps), size, size))
        for row in range(size):
            for column in range(row, size):
                result[:, row, column] = steps ** (column - row) / factorial(column - row)
        return result

    def noise(self, steps: Array) -> FloatArray:
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
