"""Numbers measured over time, smoothed: positions in one, two or three axes that move independently.

Noise that is not known is estimated by maximum likelihood, for poses as well.
"""

from collections.abc import Callable

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InsufficientData, InvalidInput, NotConverged
from camcal.estimate.smoothing.batch import (
    BatchSolution,
    MeasurementFit,
    disagreement,
    huber,
    invertible,
    is_outlier,
    require_size,
    robust_weights,
    smooth_system,
    solve_batch,
    squared_residuals,
)
from camcal.estimate.smoothing.linear_system import LinearSystem, MotionModel, kalman_filter, rts
from camcal.records import Brief

_DECADES = 5  # how far from the initial value noise is searched for, to either side
_TOLERANCE = 0.01  # of a logarithm: 1 % of q, less than any series tells
_ROUGH = 0.1  # the same where a better search follows
_ROUNDS = 2
_LEAST = 1e-50  # of a difference that tells of noise: the square of less is next to none
_NEARLY_SETTLED = 5e-3  # of a weight: enough to compare noises


_TOO_FEW = "too few {}, or none with noise, to estimate it; set --sigma and --q"


@dataclass(frozen=True)
class SmootherNoise:
    """Strength of the process noise, and standard deviation of the measurements."""

    q: float
    sigma: float


def likeliest_noise(
    system: LinearSystem, q: float | None, sigma: float | None, guess: SmootherNoise, robust: bool = False
) -> SmootherNoise:
    """Return the noise under which the measurements were most likely.

    system: with process noise of q = 1, and measurement noise of sigma = 1. q, sigma: None for what is not known.
    robust: q is found by Huber's loss first, with the guess of sigma, and then both without the outliers.
    Raises NotConverged if there is no largest likelihood near the guess.
    """
    if not robust:
        return _search(system, q, sigma, guess)
    found = _search(system, q, guess.sigma if sigma is None else sigma, guess, robust=True)
    for _ in range(_ROUNDS):
        noisy = with_noise(system, found)
        weights = robust_weights(noisy)
        means, covariances = solve_batch(invertible(noisy.weighted(weights))).smoothed()
        outliers = is_outlier(disagreement(noisy, weights, means, covariances), system.present.sum(axis=1))
        found = _search(system.without(outliers), q, sigma, SmootherNoise(found.q, guess.sigma))
    return found


def with_noise(system: LinearSystem, noise: SmootherNoise) -> LinearSystem:
    """Return a system of unit noise with this noise."""
    return replace(system, process=noise.q * system.process, noise=noise.sigma**2 * system.noise)


def _search(
    system: LinearSystem, q: float | None, sigma: float | None, guess: SmootherNoise, robust: bool = False
) -> SmootherNoise:
    guess = SmootherNoise(guess.q if q is None else q, guess.sigma if sigma is None else sigma)
    free = [name for name, value in (("q", q), ("sigma", sigma)) if value is None]
    if not free:
        return guess
    if len(free) == 2 and not robust:
        return _search_ratio(system, guess)
    likelihood = _HuberLikelihood(len(system)) if robust else log_likelihood

    def noise(numbers: Array) -> SmootherNoise:
        return replace(guess, **dict(zip(free, map(float, numbers), strict=True)))

    start = np.array([getattr(guess, name) for name in free])
    return noise(
        most_likely(
            lambda numbers: likelihood(with_noise(system, noise(numbers))), start, _ROUGH if robust else _TOLERANCE
        )
    )


def _search_ratio(system: LinearSystem, guess: SmootherNoise) -> SmootherNoise:
    """Return the most likely noise where neither number is known: at a ratio q / σ² the best σ² is known."""

    def solved(ratio: float) -> BatchSolution:
        return solve_batch(invertible(with_noise(system, SmootherNoise(ratio, 1.0))))

    def likelihood(numbers: Array) -> float:
        found = solved(float(numbers[0]))
        if found.degrees_of_freedom < 1 or not found.squares > 0:
            raise InsufficientData(_TOO_FEW.format("measurements"))
        gained = found.squares - found.degrees_of_freedom * np.log(found.squares / found.degrees_of_freedom)
        return found.log_likelihood + 0.5 * float(gained)

    ratio = float(most_likely(likelihood, np.array([guess.q / guess.sigma**2]))[0])
    best = solved(ratio)
    variance = best.squares / best.degrees_of_freedom
    return SmootherNoise(ratio * variance, float(np.sqrt(variance)))


def log_likelihood(system: LinearSystem) -> float:
    """Return the logarithm of the density of the measurements, up to a constant, states integrated out."""
    return solve_batch(invertible(system)).log_likelihood


class _HuberLikelihood:
    """The same where noise has Huber's density, integrated by Laplace's approximation.

    The weights of one system are where the search for those of the next begins, which saves half of it.
    """

    def __init__(self, count: int) -> None:
        self.weights = np.ones(count)

    def __call__(self, system: LinearSystem) -> float:
        system = invertible(system)
        weights = self.weights = robust_weights(system, self.weights, _NEARLY_SETTLED)
        solution = solve_batch(system.weighted(weights))
        squares = squared_residuals(system, solution.means)
        present = system.present
        pulled = weights * squares - huber(present.shape[1]).cost(squares)
        return solution.log_likelihood + 0.5 * float(np.sum(pulled - present.sum(axis=1) * np.log(weights)))


def most_likely(likelihood: Callable[[Array], float], guess: Array, tolerance: float = _TOLERANCE) -> Array:
    """Return the positive numbers (p,) under which `likelihood` is largest, the first of them searched widest.

    guess: (p,), to be right within a factor of 100 000. tolerance: of their logarithms. Raises NotConverged.
    Source: Nelder and Mead 1965, from the best of a grid of the first number, on logarithms.
    """
    from scipy.optimize import minimize

    def cost(logarithms: Array) -> float:
        try:
            return -likelihood(np.exp(logarithms))
        except (InsufficientData, NotConverged):  # noise so strong or weak that rounding hides what was measured
            return np.inf

    reach = _DECADES * np.log(10)
    start = np.log(guess)
    grid = [start + np.eye(len(start))[0] * offset for offset in np.linspace(-reach, reach, 11)]
    start = min(grid, key=cost)
    bounds = [(value - reach, value + reach) for value in start]
    simplex = np.vstack([start, start + np.eye(len(start))])
    with np.errstate(invalid="ignore"):  # infinite costs are subtracted where none of the numbers will do
        found = minimize(
            cost,
            start,
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": tolerance, "fatol": tolerance, "initial_simplex": simplex, "maxfev": 400},
        )
    if not found.success:
        raise NotConverged("noise cannot be estimated from the measurements: set --q and --sigma")
    return np.asarray(np.exp(found.x))


def measured_noise(values: Array, order: int, what: str = "measurements") -> float:
    """Return an initial value of the standard deviation of measurements (K, d) that move as smoothly as `order` says.

    It is that of differences so often repeated that motion hardly shows in them. Raises InsufficientData if there are
    too few, or if they hold no noise; `what` they are is said then.
    """
    from math import comb

    gain = np.sqrt(comb(2 * order, order))  # of a difference of this order
    deviations = []
    for column in values.T:
        differences = np.abs(np.diff(column[np.isfinite(column)], order))
        differences = differences[differences > _LEAST]
        if len(differences):
            deviations.append(np.median(differences) / (0.6745 * gain))
    if not deviations:
        raise InsufficientData(_TOO_FEW.format(what))
    return float(np.max(deviations))


def strength(motion: MotionModel, stamps: Array, sigma: float) -> float:
    """Return an initial value of q: over ten steps the motion's noise is as large as that of the measurements."""
    span = 10 * np.median(np.diff(stamps), keepdims=True)
    return float(sigma**2 / motion.noise(span)[0, 0, 0])


@dataclass(frozen=True, eq=False)
class Series(Brief):
    """Numbers measured at increasing stamps.

    names: of the d axes. stamps: (K,) s. values: (K, d), NaN where missing. sigma: (K, d) standard deviations of the
    measurements, or None if unknown. controls: (K, d) known displacements that arrive at each stamp, or None.
    """

    names: tuple[str, ...]
    stamps: FloatArray
    values: FloatArray
    sigma: FloatArray | None = None
    controls: FloatArray | None = None

    def __post_init__(self) -> None:
        shape = (len(self.stamps), len(self.names))
        object.__setattr__(self, "stamps", readonly(self.stamps, shape[:1], "stamps"))
        for name in ("values", "sigma", "controls"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name), shape, name))
        late = np.flatnonzero(~(np.diff(self.stamps) > 0))
        if len(late):
            raise InvalidInput(f"stamp {self.stamps[late[0] + 1]:.9g} s is not later than the one before")


@dataclass(frozen=True)
class SeriesOptions(Brief):
    """How to smooth: by which motion, with which noise.

    q: strength of the process noise (`MotionModel`), None: the most likely. method: of METHODS, both give the same
    states. robust: whether measurements that fit badly lose weight.
    """

    motion: MotionModel = field(default_factory=MotionModel)
    q: float | None = None
    method: str = "rts"
    robust: bool = False


@dataclass(frozen=True, eq=False)
class SmoothedSeries(MeasurementFit):
    """A series given all its measurements (K, d), and how these fit.

    states: (K, d, n) position and derivatives along each axis. covariances: (K, d, n, n). q, sigma: the noise, sigma
    as a single number if it was estimated, else None.
    """

    series: Series
    motion: MotionModel
    states: FloatArray
    covariances: FloatArray
    q: float
    sigma: float | None


def smooth_series(series: Series, options: SeriesOptions = SeriesOptions()) -> SmoothedSeries:
    """Return a series smoothed.

    Raises InsufficientData, naming what is not observed, if there are too few measurements, InvalidInput for numbers
    too large to compute with.
    """
    require_size(series.values, "measurements")
    _require_observed(series, options.motion)
    noise = _noise(series, options)
    system = with_noise(system_of(series, options.motion), noise)
    means, covariances, fit = smooth_system(system, options.method, options.robust)
    shape = (len(series.names), len(series.stamps))
    return SmoothedSeries(
        series=series,
        motion=options.motion,
        states=_by_axis(means, shape),
        covariances=_by_axis(covariances, shape),
        q=noise.q,
        sigma=noise.sigma if series.sigma is None else None,
        weights=_by_axis(fit.weights, shape),
        outliers=_by_axis(fit.outliers, shape),
        nis=_by_axis(fit.nis, shape),
        log_likelihood=fit.log_likelihood,
        consistency=fit.consistency,
    )


def system_of(series: Series, motion: MotionModel) -> LinearSystem:
    """Return the linear system of a series: one axis after the other, each a chain of its own.

    Its process noise is that of q = 1, its measurement noise that of the series, or of sigma = 1 where it has none.
    """
    axes = len(series.names)
    between = np.diff(series.stamps)
    last = np.zeros((1, len(motion.states), len(motion.states)))
    transitions = np.tile(np.concatenate([motion.transition(between), last]), (axes, 1, 1))[:-1]
    process = np.tile(np.concatenate([motion.noise(between), last]), (axes, 1, 1))[:-1]
    linked = np.tile(np.append(np.ones(len(between), bool), False), axes)[:-1]
    controls = np.zeros((len(linked), len(motion.states)))
    if series.controls is not None:
        controls[:, 0] = series.controls.T.ravel()[1:]
    sigma = np.ones_like(series.values) if series.sigma is None else series.sigma
    noise = sigma.T.reshape(-1, 1, 1) ** 2
    observation = np.eye(1, len(motion.states))
    return LinearSystem(
        transitions,
        controls,
        process=process,
        linked=linked,
        observation=observation,
        measurements=series.values.T.reshape(-1, 1),
        noise=noise,
    )


def series_at(smoothed: SmoothedSeries, stamps: Array) -> SmoothedSeries:
    """Return a smoothed series at other stamps (M,): states and covariances as its motion model has them there.

    A smoother takes stamps at which nothing was measured; noise that composes makes no difference of them.
    """
    series = smoothed.series
    everything = np.union1d(series.stamps, stamps)
    rows = np.searchsorted(everything, series.stamps)
    sigma = np.ones_like(series.values) if series.sigma is None else series.sigma

    def spread(values: Array, empty: float) -> Array:
        result = np.full((len(everything), values.shape[1]), empty)
        result[rows] = values
        return result

    wider = Series(
        series.names,
        everything,
        spread(series.values, np.nan),
        spread(sigma / np.sqrt(smoothed.weights), 1.0),
        None if series.controls is None else spread(series.controls, 0.0),
    )
    system = with_noise(system_of(wider, smoothed.motion), SmootherNoise(smoothed.q, smoothed.sigma or 1.0))
    means, covariances = rts(system, kalman_filter(system))  # by filter: stamps may lie very near each other
    wanted, shape = np.searchsorted(everything, stamps), (len(series.names), len(everything))
    missing = np.full((len(stamps), len(series.names)), np.nan)
    return replace(
        smoothed,
        series=Series(series.names, stamps, missing),
        states=_by_axis(means, shape)[wanted],
        covariances=_by_axis(covariances, shape)[wanted],
        weights=np.ones_like(missing),
        outliers=np.zeros(missing.shape, bool),
        nis=missing,
    )


def _noise(series: Series, options: SeriesOptions) -> SmootherNoise:
    """Return q and sigma; sigma 1 if the series has its own."""
    if options.q is not None and series.sigma is not None:
        return SmootherNoise(options.q, 1.0)
    if series.sigma is None:
        guess = measured_noise(series.values, len(options.motion.states) + 1)
    else:
        guess = float(np.median(series.sigma))
    start = SmootherNoise(strength(options.motion, series.stamps, guess), guess)
    sigma = None if series.sigma is None else 1.0
    return likeliest_noise(system_of(series, options.motion), options.q, sigma, start, options.robust)


def _require_observed(series: Series, motion: MotionModel) -> None:
    if not len(series.stamps):
        raise InsufficientData("no measurements")
    system = system_of(series, motion)
    missing = [
        f"{motion.states[state]} of {series.names[axis]}"
        for axis, states in system.unobserved().items()
        for state in states
    ]
    if missing:
        fewest = int(np.isfinite(series.values).sum(axis=0).min())
        raise InsufficientData(
            f"not observed: {', '.join(missing)} ({fewest} measurements, "
            f"model {motion.name} needs {len(motion.states)} at different times)"
        )


def _by_axis(stacked: Array, shape: tuple[int, int]) -> Array:
    """Return what stands axis after axis, (d K, …), as (K, d, …)."""
    return np.swapaxes(stacked.reshape(*shape, *stacked.shape[1:]), 0, 1)
