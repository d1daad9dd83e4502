"""Numbers measured over time, smoothed: positions in one, two or three axes that move independently."""

from dataclasses import dataclass, field, replace

import numpy as np

from camcal.arrays import Array, FloatArray, readonly
from camcal.brief import Brief
from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.smoothing.batch import MeasurementFit, require_size, smooth_system
from camcal.estimate.smoothing.linear_system import LinearSystem, MotionModel, kalman_filter, rts
from camcal.estimate.smoothing.tuning import (
    KnownSmootherNoise,
    SmootherNoise,
    likeliest_noise,
    measured_noise,
    strength,
    with_noise,
)


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
    found = smooth_system(system, options.method, options.robust)
    shape = (len(series.names), len(series.stamps))
    return SmoothedSeries(
        series=series,
        motion=options.motion,
        states=_by_axis(found.states.means, shape),
        covariances=_by_axis(found.states.covariances, shape),
        q=noise.q,
        sigma=noise.sigma if series.sigma is None else None,
        weights=_by_axis(found.weights, shape),
        outliers=_by_axis(found.outliers, shape),
        nis=_by_axis(found.nis, shape),
        log_likelihood=found.log_likelihood,
        consistency=found.consistency,
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
    found = rts(system, kalman_filter(system))  # by filter: stamps may lie very near each other
    wanted, shape = np.searchsorted(everything, stamps), (len(series.names), len(everything))
    missing = np.full((len(stamps), len(series.names)), np.nan)
    return replace(
        smoothed,
        series=Series(series.names, stamps, missing),
        states=_by_axis(found.means, shape)[wanted],
        covariances=_by_axis(found.covariances, shape)[wanted],
        weights=np.ones_like(missing),
        outliers=np.zeros(missing.shape, bool),
        nis=missing,
    )


def _noise(series: Series, options: SeriesOptions) -> SmootherNoise:
    """Return q and sigma; sigma 1 if the series has its own."""
    known = KnownSmootherNoise(options.q, None if series.sigma is None else 1.0)
    if known.q is not None and known.sigma is not None:
        return SmootherNoise(known.q, known.sigma)
    if series.sigma is None:
        guess = measured_noise(series.values, len(options.motion.states) + 1)
    else:
        guess = float(np.median(series.sigma))
    start = SmootherNoise(strength(options.motion, series.stamps, guess), guess)
    return likeliest_noise(system_of(series, options.motion), known, start, options.robust)


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
