"""The figures of one phase of a sensor, from its photon transfer curve and its levels of light and darkness.

Source: EMVA Standard 1288, Release 4.0 Linear (2021).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from math import hypot, log, log10, sqrt
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.raw.counting import ROUNDING, before_counting, root, squared
from camcal.raw.level import Level
from camcal.raw.photon_transfer import Curve, Figure

_LINEAR = (0.05, 0.95)  # of saturation: where linearity is asked for
_FEWEST_LINEAR = 3  # levels: a line goes through two
_DECIBEL = 20 / log(10)
_PATTERNS = ("dsnu_e", "prnu")


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
        known = [figure for part in parts if (figure := getattr(part, field.name)) is not None]
        if field.name in _PATTERNS and known:
            means[field.name] = Figure(*root(*_mean([Figure(*squared(*figure)) for figure in known])))
        else:
            means[field.name] = _mean(known) if known else None
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
    known = [level for level in darks if level.exposure_s is not None]
    if len({level.exposure_s for level in known}) < 2:
        return None
    exposure = np.array([level.exposure_s for level in known])
    means = [before_counting(level.counted(phase)).mean for level in known]
    std = np.array([sqrt(level.temporal[phase] / (level.samples * level.frames)) for level in known])
    std = np.maximum(std, 1e-6)  # where rounding leaves no noise at all
    from_mean = exposure - np.average(exposure, weights=std**-2)
    slopes = from_mean / std**2
    slope = float(slopes @ means / (slopes @ exposure))
    return _over(Figure(slope, float(1 / sqrt(slopes @ exposure))), gain)
