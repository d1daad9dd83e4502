"""Sensor characterisation (EMVA 1288) from levels of light and of darkness: figures of every Bayer phase, and of all.

The photon transfer curve says how noise grows with light, and where it ends. Photons arrive by chance, so that their
variance is their number: of counts above black x the variance is K x + σ², where K is the gain in counts per electron.
Source: EMVA Standard 1288, Release 4.0 Linear (2021; noise model, photon transfer method). Its saturation is the signal
of the largest variance, which lies three deviations below the full well and depends on the levels taken; here it is the
signal at which pixels are full.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from math import hypot, log, log10, sqrt
from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import Message
from camcal.raw.level import ROUNDING, SIGNIFICANT, DarkSignal, Level, before_counting, drifts, root, squared

_FITTED = 0.7  # of the signal of the largest variance: as EMVA 1288 has it
_CLIPPED = 1e-3  # share of samples at 0 or at white that makes a level useless for its variance
_SATURATED = 0.35  # of the variance expected: where a clipped Gaussian is half full, within 0.4 σ of its limit
_COMPLETE = 0.9  # of the variance expected: nothing was cut off
_ROUNDS = 3  # of weighting by the variance that the fit before expects

_LINEAR = (0.05, 0.95)  # of saturation: where linearity is asked for
_FEWEST_LINEAR = 3  # levels: a line goes through two
_DECIBEL = 20 / log(10)
_PATTERNS = ("dsnu_e", "prnu")


class Figure(NamedTuple):
    """A measured number and its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Curve:
    """The photon transfer curve of a phase, its L levels in the order of their signal.

    signal: (L,) mean counts above black. variance: (L,) counts², without that of rounding. exposure_s: (L,) seconds,
    NaN where unknown. fitted: (L,) levels that the gain was measured with. noise: of the dark frames, whose mean is
    black. gain: counts per electron. intercept: counts², of the fit. saturation: counts above black at which pixels
    are full, None where the light did not reach that far.
    """

    signal: Array
    variance: Array
    exposure_s: Array
    fitted: Array
    noise: DarkSignal
    gain: Figure
    intercept: float
    saturation: float | None

    def __post_init__(self) -> None:
        for name in ("signal", "variance", "exposure_s"):
            object.__setattr__(self, name, readonly(getattr(self, name), (None,), name))
        object.__setattr__(self, "fitted", readonly(self.fitted, (len(self.signal),), "fitted", bool))

    @property
    def expected(self) -> Array:
        """Variance (L,), counts², that the fit expects of every level."""
        return np.asarray(self.gain.value * self.signal + self.intercept)

    @property
    def complete(self) -> Array:
        """The mask (L,) of levels at which no pixel was cut off, as far as their variance tells."""
        return self.variance > _COMPLETE * self.expected


def transfer_curve(flats: Sequence[Level], dark: Level, phase: int) -> Curve:
    """Return the photon transfer curve of a phase, by its place in the levels' names.

    flats: in any order. dark: of the shortest exposure. Raises InsufficientData if nothing is left between darkness
    and saturation, or if the noise does not grow with the light.
    """
    noise = before_counting(dark.counted(phase))
    flats = sorted(flats, key=lambda level: float(level.mean_dn[phase]))
    signal = np.array([level.mean_dn[phase] for level in flats]) - noise.mean
    variance = np.array([level.temporal[phase] for level in flats]) - ROUNDING
    fitted = _usable(flats, phase, signal, variance)
    degrees = np.array([level.degrees for level in flats])
    gain, intercept = _fit(signal[fitted], variance[fitted], degrees[fitted], noise)
    exposures = [np.nan if level.exposure_s is None else level.exposure_s for level in flats]
    full = variance < _SATURATED * (gain.value * signal + intercept)
    saturation = float(signal[full].max()) if full.any() else None
    return Curve(
        signal=signal,
        variance=variance,
        exposure_s=np.array(exposures),
        fitted=fitted,
        noise=noise,
        gain=gain,
        intercept=intercept,
        saturation=saturation,
    )


def _usable(flats: Sequence[Level], phase: int, signal: Array, variance: Array) -> Array:
    """Return the mask (L,) of levels between darkness and the signal at which full pixels begin to lower the noise."""
    whole = np.array([level.clipped[phase] < _CLIPPED for level in flats]) & (signal > 0)
    if not whole.any():
        name = flats[0].names[phase]
        clipped = min(level.clipped[phase] for level in flats)
        raise InsufficientData(
            f"no flat frame between darkness and saturation: of the {name} pixels at least {100 * clipped:.3g} % are "
            f"at 0 or at white ({flats[0].white:g}); expose less, or give the right --white"
        )
    peak = signal[whole][np.argmax(variance[whole])]
    below = whole & (signal <= _FITTED * peak)
    return np.asarray(below if below.any() else whole & (signal <= peak))


def _fit(signal: Array, variance: Array, degrees: Array, noise: DarkSignal) -> tuple[Figure, float]:
    """Return the gain and the intercept of variance = gain · signal + intercept through flats and darks.

    Weights are those of the variance of a variance, 2 σ⁴ / degrees, of what the fit before expects: weights from the
    measured variance itself would favour the levels that came out low.
    """
    x = np.append(signal, 0.0)
    y = np.append(variance, noise.std**2)
    design = np.column_stack([x, np.ones_like(x)])
    expected = np.maximum(y, ROUNDING)
    for _ in range(_ROUNDS):
        std = np.append(np.sqrt(2 / degrees) * (expected[:-1] + ROUNDING), 2 * noise.std * noise.std_uncertainty)
        weighted = design / std[:, None]
        covariance = np.linalg.inv(weighted.T @ weighted)
        gain, intercept = covariance @ weighted.T @ (y / std)
        expected = np.maximum(design @ (gain, intercept), ROUNDING)
    error = np.sqrt(covariance[0, 0])
    if not gain > 3 * error:
        raise InsufficientData(
            "the noise of the flat frames does not increase with the signal: saturated, too dark or not raw"
        )
    residual = (y - design @ (gain, intercept)) / std
    excess = np.square(residual).sum() / max(len(x) - 2, 1)
    return Figure(float(gain), float(error * np.sqrt(max(excess, 1.0)))), float(intercept)


@dataclass(frozen=True)
class Figures:
    """What was measured; None where the frames do not tell.

    gain_dn_per_e: counts per electron. read_noise_e: of the shortest dark frames. full_well_e: electrons at which
    counts end. dynamic_range_db: full well over read noise. threshold_e: the signal that equals its noise;
    emva_dynamic_range_db: full well over that. snr_max_db: at full well. dsnu_e, prnu: standard deviations of the
    pixels' dark signals and of their responses (a share). linearity_error: mean deviation from a line, a share.
    """

    gain_dn_per_e: Figure
    read_noise_e: Figure
    full_well_e: Figure
    dynamic_range_db: Figure
    threshold_e: Figure
    emva_dynamic_range_db: Figure
    snr_max_db: Figure
    black_dn: Figure
    dsnu_e: Figure
    prnu: Figure
    linearity_error: Figure | None
    dark_current_e_s: Figure | None


def figures_of(curve: Curve, phase: int, flats: Sequence[Level], darks: Sequence[Level], white: float) -> Figures:
    """Return the figures of a phase; darks by rising exposure; white is where counts end if the light did not."""
    gain, noise, dark = curve.gain, curve.noise, darks[0]
    limit = white - noise.mean if curve.saturation is None else curve.saturation
    read = _over(Figure(noise.std, noise.std_uncertainty), gain)
    full = _over(Figure(limit, sqrt(noise.std**2 / dark.samples)), gain)
    # The absolute sensitivity threshold, where the signal-to-noise ratio is 1; the noise includes that of rounding.
    counted = sqrt(noise.std**2 + ROUNDING) / gain.value
    threshold = sqrt(counted**2 + 1 / 4) + 1 / 2
    threshold_std = counted / (threshold - 1 / 2) * read.std
    return Figures(
        gain_dn_per_e=gain,
        read_noise_e=read,
        full_well_e=full,
        # The gain is in both and cancels.
        dynamic_range_db=Figure(_decibels(limit / noise.std), _DECIBEL * noise.std_uncertainty / noise.std),
        threshold_e=Figure(threshold, threshold_std),
        emva_dynamic_range_db=Figure(
            _decibels(full.value / threshold), _DECIBEL * hypot(full.std / full.value, threshold_std / threshold)
        ),
        snr_max_db=Figure(_decibels(sqrt(full.value)), _DECIBEL / 2 * full.std / full.value),
        black_dn=Figure(noise.mean, sqrt(dark.temporal[phase] / (dark.samples * dark.frames))),
        dsnu_e=_over(Figure(noise.spread, noise.spread_uncertainty), gain),
        prnu=_response(curve, phase, flats, dark, limit),
        linearity_error=_linearity(curve, limit, dark.samples),
        dark_current_e_s=_dark_current(darks, phase, gain),
    )


def together(parts: Iterable[Figures]) -> Figures:
    """Return the weighted means of the figures of several phases; of patterns the means of their variances."""
    parts = list(parts)
    means: dict[str, Any] = {}
    for field in fields(Figures):
        figures = [figure for part in parts if (figure := getattr(part, field.name)) is not None]
        if field.name in _PATTERNS and figures:
            means[field.name] = Figure(*root(*_mean([Figure(*squared(*figure)) for figure in figures])))
        else:
            means[field.name] = _mean(figures) if figures else None
    return Figures(**means)


def _mean(known: Sequence[Figure]) -> Figure:
    if any(figure.std == 0 for figure in known):
        return Figure(float(np.mean([figure.value for figure in known])), 0.0)
    weights = np.array([1 / figure.std**2 for figure in known])
    return Figure(float(weights @ [figure.value for figure in known] / weights.sum()), float(weights.sum() ** -0.5))


def _over(counts: Figure, gain: Figure) -> Figure:
    """Return counts in electrons."""
    value = counts.value / gain.value
    return Figure(value, hypot(counts.std / gain.value, value * gain.std / gain.value))


def _decibels(ratio: float) -> float:
    return 20 * log10(ratio)


def _response(curve: Curve, phase: int, flats: Sequence[Level], dark: Level, limit: float) -> Figure:
    """Return the standard deviation of the pixels' response, a share of it, at the level nearest half of saturation.

    Source: spatial variances, PRNU² = (s² of light - s² of darkness) / signal².
    """
    signals = [level.mean_dn[phase] - curve.noise.mean for level in flats]
    usable = set(curve.signal[curve.fitted].tolist())
    signal, level = min(
        ((float(signal), level) for signal, level in zip(signals, flats, strict=True) if signal in usable),
        key=lambda pair: abs(pair[0] - limit / 2),
    )
    variance = (float(level.spatial[phase]) - curve.noise.spread**2) / signal**2
    return Figure(*root(variance, hypot(level.spatial_std(phase), dark.spatial_std(phase)) / signal**2))


def _linearity(curve: Curve, limit: float, samples: int) -> Figure | None:
    """Return the mean deviation, a share, of signals from their line over exposure; None without enough exposures."""
    deviation = line_deviation(curve, limit)
    used = np.isfinite(deviation)
    if not used.any():
        return None
    chance = np.sqrt(curve.variance[used] / samples) / curve.signal[used]
    return Figure(float(np.abs(deviation[used]).mean()), float(np.sqrt(np.square(chance).sum()) / used.sum()))


def line_deviation(curve: Curve, limit: float) -> Array:
    """Return by what share (L,) signals deviate from their line over exposure; NaN where the line is not fitted.

    The line has the least relative deviations from 5 to 95 % of saturation, `limit` counts above black, and needs
    three exposures there, none of them twice.
    """
    low, high = (share * limit for share in _LINEAR)
    used = np.isfinite(curve.exposure_s) & (curve.signal >= low) & (curve.signal <= high) & curve.complete
    exposure, signal = curve.exposure_s[used], curve.signal[used]
    result = np.full(len(curve.signal), np.nan)
    if len(set(exposure)) == len(exposure) >= _FEWEST_LINEAR:  # else the light was varied, not the exposure
        line = np.polyfit(exposure, signal, 1, w=1 / signal)
        result[used] = signal / np.polyval(line, exposure) - 1
    return result


def _dark_current(darks: Sequence[Level], phase: int, gain: Figure) -> Figure | None:
    """Return electrons per second from the growth of the dark signal with exposure; None with a single exposure."""
    exposed = [level for level in darks if level.exposure_s is not None]
    if len({level.exposure_s for level in exposed}) < 2:
        return None
    exposure = np.array([level.exposure_s for level in exposed])
    means = [before_counting(level.counted(phase)).mean for level in exposed]
    std = np.array([sqrt(level.temporal[phase] / (level.samples * level.frames)) for level in exposed])
    std = np.maximum(std, 1e-6)  # where rounding leaves no noise at all
    from_mean = exposure - np.average(exposure, weights=std**-2)
    slopes = from_mean / std**2
    slope = float(slopes @ means / (slopes @ exposure))
    return _over(Figure(slope, float(1 / sqrt(slopes @ exposure))), gain)


DECIBELS_A_STOP = 20 * log10(2)
FULL_WELL, WHITE_LEVEL, NOT_REACHED = "full well", "white level", "not reached"

_DRIFT = (0.01, 0.2)  # of the signal between frames of one level: what is warned of, what is refused
_SAME_GAIN = 0.02  # by which the gains of two phases may differ
_CUT_OFF = 1e-3  # share of dark samples at 0


@dataclass(frozen=True, eq=False)
class Characterisation:
    """The figures of a sensor, over all phases and of each, and the photon transfer curves they come from.

    saturation: what ends the counts, "full well" or "white level", or "not reached" by the light: then the full well
    is the white level's. white: counts at saturation; peak: the largest count seen. limited: the read noise is hidden
    by rounding to whole counts.
    """

    size: tuple[int, int]
    white: float
    peak: float
    figures: Figures
    phases: Mapping[str, Figures]
    curves: Mapping[str, Curve]
    saturation: str
    limited: bool
    warnings: tuple[Message, ...]

    @property
    def dynamic_range_stops(self) -> float:
        return self.figures.dynamic_range_db.value / DECIBELS_A_STOP


def characterise(flats: Sequence[Level], darks: Sequence[Level]) -> Characterisation:
    """Return what a sensor can do from levels of light and at least one level of darkness.

    Raises InsufficientData if the levels tell no gain, if there are none, or if the light
    of frames of one level differed widely; InvalidInput if they differ in size.
    """
    _require_comparable(flats, darks)
    changes = list(drifts(flats, darks))
    for level, share in changes:
        if share > _DRIFT[1]:
            text = f"frames of one level ({level.words}) differ by {100 * share:.0f} % in brightness"
            raise InsufficientData(f"{text}: check for mixed exposures or flicker")
    darks = sorted(darks, key=lambda level: level.exposure_s or 0.0)
    names, white = flats[0].names, min(level.white for level in flats)
    curves = {name: transfer_curve(flats, darks[0], phase) for phase, name in enumerate(names)}
    ends = [curve.saturation + curve.noise.mean for curve in curves.values() if curve.saturation is not None]
    reached = {name for name, curve in curves.items() if curve.saturation is not None}
    phases = {name: figures_of(curve, phase, flats, darks, white) for phase, (name, curve) in enumerate(curves.items())}
    return Characterisation(
        size=flats[0].size,
        white=white,
        peak=max(level.peak for level in flats),
        figures=together(phases[name] for name in names if name in reached or not reached),
        phases=phases,
        curves=curves,
        saturation=NOT_REACHED if not ends else WHITE_LEVEL if max(ends) > white - 1 else FULL_WELL,
        limited=any(curve.noise.limited for curve in curves.values()),
        warnings=tuple(_warnings(changes, flats, darks, curves, phases, white)),
    )


def _require_comparable(flats: Sequence[Level], darks: Sequence[Level]) -> None:
    for levels, kind in ((flats, "flat"), (darks, "dark")):
        if not levels:
            raise InsufficientData(f"no {kind} frames; photon transfer needs two flat and two dark frames at least")
    first = flats[0]
    for level in (*flats, *darks):
        if (level.size, level.names) != (first.size, first.names):
            sizes = " and ".join(f"{size[0]} × {size[1]}" for size in (first.size, level.size))
            raise InvalidInput(f"frames of {sizes}, or of two patterns: flat and dark frames must be alike")
    brightest, dark = max(level.mean_dn.mean() for level in flats), min(level.mean_dn.mean() for level in darks)
    if brightest < dark:
        raise InsufficientData(
            f"the flat frames are darker than the dark ones (mean {brightest:.4g} and {dark:.4g}): check --dark"
        )
    white, darkest = flats[0].white, min(level.mean_dn.min() for level in (*flats, *darks))
    if darkest >= white:
        raise InsufficientData(f"all counts are above the white level of {white:g}, {darkest:.4g} in the mean at least")


def _warnings(
    changes: Sequence[tuple[Level, float]],
    flats: Sequence[Level],
    darks: Sequence[Level],
    curves: Mapping[str, Curve],
    phases: Mapping[str, Figures],
    white: float,
) -> Iterator[Message]:
    """Yield the warnings about the frames and the figures; changes: of brightness, see `drifts`."""
    for level, share in changes:
        if share > _DRIFT[0]:
            text = f"illumination changed by {100 * share:.2g} % between frames of one level ({level.words})"
            yield Message("unstable_illumination", text, {"change": share})
    if all(curve.saturation is None for curve in curves.values()):
        peak = max(level.peak for level in flats)
        text = (
            f"saturation not reached (largest count {peak:g}): full well assumed at the white level, {white:g} counts; "
            "add longer exposures or set --white"
        )
        yield Message("saturation_not_reached", text, {"peak_dn": peak, "white_dn": white})
    if max(level.clipped.max() for level in darks) > _CUT_OFF:
        yield Message("dark_clipped", "dark counts clipped at 0, dark noise underestimated: use a higher black level")
    if any(curve.noise.limited for curve in curves.values()):
        yield Message("quantisation_limited", "read noise below the quantisation noise: use a higher gain")
    gains = {name: figures.gain_dn_per_e for name, figures in phases.items()}
    for (name, one), (other_name, other) in combinations(gains.items(), 2):
        apart = abs(one.value - other.value)
        if apart > SIGNIFICANT * hypot(one.std, other.std) and apart > _SAME_GAIN * one.value:
            text = f"gains of {name} and {other_name} differ ({one.value:.4g} and {other.value:.4g} DN/e)"
            yield Message("gains_differ", text, {name: one.value, other_name: other.value})
            return
