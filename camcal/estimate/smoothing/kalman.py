"""The steps of a Kalman filter and of its smoother, on vectors or on the error of a state; the extended filter.

A linear filter keeps its state in `Gaussian.mean`. One on rotations keeps poses outside and lets the mean be the error
of the pose, zero after every correction: the same steps serve both. `consistency` says whether the errors are as large
as the noise a filter was told claims; whole series are in `linear_system`.

In the extended filter motion and measurement are any functions, each with its Jacobian beside it:
x_{k+1} = f(x_k, dt) + w, w ~ N(0, Q);  y_k = h(x_k) + n, n ~ N(0, R). Noise that enters elsewhere goes into Q as
G Q Gᵀ. What is measured on a circle or a sphere is compared by `difference`, not by subtraction.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, ch. 5, 8 and 10.3.
"""

from collections.abc import Callable, Sequence

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.records import Brief

_LOG_2PI = float(np.log(2 * np.pi))

CONSISTENT, OVERCONFIDENT, UNDERCONFIDENT = "consistent", "overconfident", "underconfident"
CORRELATED, NOT_JUDGED, AMBIGUOUS = "correlated", "not judged", "ambiguous"
_NEAR_ONE = 0.1  # a mean NIS this near to 1 means standard deviations right to 5 %: no reason to change anything
_CONFIDENCE = 0.95
_MANY = 0.08  # of innovations beyond their 95 % bound
_NOT_JUDGED = Message("consistency_unknown", "consistency unknown: no measurement was predicted from earlier ones")


@dataclass(frozen=True, eq=False)
class Gaussian(Brief):
    """A mean (n,) and a covariance (n, n), in the units of the state."""

    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", readonly(self.mean, (None,), "mean"))
        size = len(self.mean)
        object.__setattr__(self, "covariance", readonly(self.covariance, (size, size), "covariance"))


@dataclass(frozen=True, eq=False)
class Updated:
    """A state after a measurement, and how the measurement fits what was expected of it.

    nis: normalised innovation squared, χ² of m degrees of freedom if all noise is as assumed. whitened: (m,) the
    innovation in units of its own noise. log_likelihood: of the measurement, given all before it.
    innovation_covariance: (m, m).
    """

    state: Gaussian
    nis: float
    log_likelihood: float
    innovation_covariance: FloatArray
    whitened: FloatArray


def predict(state: Gaussian, F: Array, Q: Array, control: Array | None = None) -> Gaussian:
    """Return the state a step later: F x + control, with covariance F P Fᵀ + Q.

    F: (n, n), of a non-linear motion its Jacobian (then give the mean by `control`). Q: (n, n). control: (n,).
    """
    mean = F @ state.mean if control is None else F @ state.mean + control
    return Gaussian(mean, _symmetric(F @ state.covariance @ F.T + Q))


def update(state: Gaussian, innovation: Array, H: Array, R: Array) -> Updated:
    """Return the state corrected by a measurement.

    innovation: (m,) measured minus expected; where the measurement is no vector, its difference as one (an angle
    wrapped, a rotation's logarithm). H: (m, n) = d expected / d state. R: (m, m), the sensor's covariance.
    The covariance is Joseph's, (I - K H) P (I - K H)ᵀ + K R Kᵀ: P - K H P loses symmetry and is true of one gain only.
    Raises InvalidInput if the innovation has no proper covariance.
    """
    cross = H @ state.covariance
    S = _symmetric(cross @ H.T + R)
    whitener = _whitener(S)
    whitened = whitener @ innovation
    gain = cross.T @ (whitener.T @ whitener)
    keep = np.eye(len(state.mean)) - gain @ H
    covariance = _symmetric(keep @ state.covariance @ keep.T + gain @ R @ gain.T)
    nis = float(whitened @ whitened)
    log_likelihood = np.log(whitener.diagonal()).sum() - 0.5 * (nis + len(innovation) * _LOG_2PI)
    return Updated(Gaussian(state.mean + gain @ innovation, covariance), nis, float(log_likelihood), S, whitened)


def smooth_back(filtered: Gaussian, predicted: Gaussian, smoothed: Gaussian, F: Array) -> Gaussian:
    """Return the state at a step given all measurements, from the smoothed state of the next step.

    filtered: the state at this step. predicted: of the next one, before its measurement. F: between them.
    Source: Rauch, Tung, Striebel 1965.
    """
    gain = np.linalg.solve(predicted.covariance, F @ filtered.covariance).T  # P Fᵀ P⁻¹, P the next one's last
    mean = filtered.mean + gain @ (smoothed.mean - predicted.mean)
    change = gain @ (smoothed.covariance - predicted.covariance) @ gain.T
    return Gaussian(mean, _symmetric(filtered.covariance + change))


def gate(dof: float, confidence: float = 0.999) -> float:
    """Return what the NIS of a good measurement stays below, with this probability: the quantile of χ²."""
    from scipy.special import gammaincinv  # χ² without scipy.stats, which takes a second to import

    return float(2 * gammaincinv(dof / 2, confidence))


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _whitener(S: Array) -> Array:
    """Return W with W S Wᵀ = 1, of a covariance of few numbers."""
    try:
        # Most measurements are one number: its root is ten times faster than LAPACK's.
        if len(S) == 1 and S[0, 0] > 0:
            return np.asarray(S**-0.5)
        return np.linalg.inv(np.linalg.cholesky(S))
    except np.linalg.LinAlgError as error:
        raise InvalidInput("a measurement's covariance is not positive definite: check for sigma = 0") from error


@dataclass(frozen=True)
class Consistency:
    """How innovations compare with what was claimed of them.

    innovations: how many. mean_nis: mean normalised innovation squared of one degree of freedom, 1 if all is right.
    interval: in which it lies with 95 % if all is right. beyond_95: share of innovations beyond their own 95 % bound.
    autocorrelation: of successive innovations, 0 if all is right; autocorrelation_limit: its 95 % bound.
    verdict: consistent, overconfident, underconfident, correlated where innovations of the right size are not
    independent, not judged without innovations, or, of poses, ambiguous where too many may be another pose.
    warning: what is wrong and what to do, None if all is right.
    """

    innovations: int
    mean_nis: float
    interval: tuple[float, float]
    beyond_95: float
    autocorrelation: float
    autocorrelation_limit: float
    verdict: str
    warning: Message | None

    def data(self) -> dict[str, object]:
        """Return the figures and the verdict as plain data; warnings are given with those of all else."""
        return {name: value for name, value in vars(self).items() if name != "warning"}


def consistency(nis: Array, dof: Array, pairs: tuple[Array, Array]) -> Consistency:
    """Return a consistency check of innovations.

    nis: (N,) their normalised squares. dof: (N,) the numbers each has. pairs: two arrays (M,) of whitened numbers,
    the second measured one step after the first, of the same kind.
    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    if len(nis) == 0:
        unknown = float("nan")
        return Consistency(
            0,
            unknown,
            interval=(unknown, unknown),
            beyond_95=unknown,
            autocorrelation=0.0,
            autocorrelation_limit=1.0,
            verdict=NOT_JUDGED,
            warning=_NOT_JUDGED,
        )
    total = float(np.sum(dof))
    mean = float(np.sum(nis)) / total
    tail = (1 - _CONFIDENCE) / 2
    low, high = (gate(total, level) / total for level in (tail, 1 - tail))
    limits = {number: gate(number, _CONFIDENCE) for number in np.unique(dof).tolist()}
    beyond = float(np.mean(nis > [limits[number] for number in dof.tolist()]))
    correlation, limit = _autocorrelation(*pairs)
    verdict, least = _verdict(mean, low, high), max(limit, _NEAR_ONE)
    figures = {"mean_nis": mean, "autocorrelation": correlation, "beyond_95": beyond}
    warning = _warning(verdict, correlation > least, correlation < -least, beyond > _MANY)
    return Consistency(
        len(nis),
        mean,
        interval=(low, high),
        beyond_95=beyond,
        autocorrelation=correlation,
        autocorrelation_limit=limit,
        verdict=CORRELATED if verdict == CONSISTENT and abs(correlation) > least else verdict,
        warning=None if warning is None else replace(warning, values=figures),
    )


def successive(whitened: Array, chains: Array) -> tuple[Array, Array]:
    """Return whitened innovations (N, m), NaN where there is none, paired with the next of the same chain.

    chains: (N,) innovations of one number belong together. Returns two arrays (M,).
    """
    pairs: tuple[list[Array], list[Array]] = ([], [])
    for chain in np.unique(chains):
        for column in whitened[chains == chain].T:
            present = column[np.isfinite(column)]
            pairs[0].append(present[:-1])
            pairs[1].append(present[1:])
    return np.concatenate(pairs[0] or [np.empty(0)]), np.concatenate(pairs[1] or [np.empty(0)])


def _autocorrelation(first: Array, second: Array) -> tuple[float, float]:
    """Return the correlation of successive numbers of mean 0 and the 95 % bound of white noise; 0 and 1 without any."""
    scale = np.sqrt(np.sum(first**2) * np.sum(second**2))
    if not scale > 0:
        return 0.0, 1.0
    return float(np.sum(first * second) / scale), float(min(1.96 / np.sqrt(len(first)), 1.0))


def _verdict(mean: float, low: float, high: float) -> str:
    if low <= mean <= high or abs(mean - 1) <= _NEAR_ONE:
        return CONSISTENT
    return OVERCONFIDENT if mean > 1 else UNDERCONFIDENT


def _warning(verdict: str, lasting: bool, alternating: bool, many_large: bool) -> Message | None:
    """Return what is wrong with the noise or the model, None if nothing is; options are those of `camcal smooth`.

    lasting: errors stay from step to step, a motion the model does not follow. alternating: they change sign from step
    to step, as where a filter follows the noise of its measurements. many_large: more innovations are beyond their
    bound than noise makes.
    """
    if verdict == OVERCONFIDENT:
        slow = lasting and not alternating
        remedy = "process noise too low, increase --q" if slow else "increase the measurement noise, --sigma"
        return Message("overconfident", f"innovations larger than their covariances: {remedy}")
    if alternating:
        remedy = "reduce the process noise, --q" + (", or increase --sigma" if verdict == CONSISTENT else "")
        return Message("filter_gain_too_high", f"filter gain too high: {remedy}")
    if verdict == UNDERCONFIDENT:
        return Message("underconfident", "innovations smaller than their covariances: reduce --sigma or --q")
    if lasting:
        return Message("correlated_innovations", "successive innovations are correlated: try another motion --model")
    if many_large:
        return Message("heavy_tails", "too many large innovations for normal noise: use --robust huber")
    return None


@dataclass(frozen=True)
class ExtendedModel(Brief):
    """A motion and a measurement of a state (n,), dt in seconds.

    f(x, dt): the next state (n,). F(x, dt): its Jacobian (n, n). Q(x, dt): process noise (n, n). h(x): the expected
    measurement (m,). H(x): its Jacobian (m, n). R: (m, m). difference(y, expected): (m,) their difference as a vector.
    """

    f: Callable[[FloatArray, float], FloatArray]
    F: Callable[[FloatArray, float], FloatArray]
    Q: Callable[[FloatArray, float], FloatArray]
    h: Callable[[FloatArray], FloatArray]
    H: Callable[[FloatArray], FloatArray]
    R: FloatArray
    difference: Callable[[FloatArray, FloatArray], FloatArray] = np.subtract


@dataclass(frozen=True, eq=False)
class ExtendedRun:
    """What a filter knew at each of K stamps, before and after its measurement.

    updates: None where nothing was measured. transitions: (K - 1, n, n) Jacobians of the motion.
    """

    predicted: tuple[Gaussian, ...]
    states: tuple[Gaussian, ...]
    updates: tuple[Updated | None, ...]
    transitions: FloatArray

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
        step = None
        if measured is not None:
            innovation = model.difference(measured, model.h(before.mean))
            step = update(before, innovation, model.H(before.mean), model.R)
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
