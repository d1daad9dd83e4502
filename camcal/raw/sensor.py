"""Sensor characterisation (EMVA 1288) from flat and dark frames.

Source: EMVA Standard 1288, Release 4.0 Linear (2021). Its saturation is the signal of the largest variance, which lies
three deviations below the full well and depends on the levels taken; here it is the signal at which pixels are full.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import hypot, log10

import numpy as np

from camcal.errors import InsufficientData, InvalidInput
from camcal.messages import Message
from camcal.raw.emva import Curve, Figures, figures_of, together, transfer_curve
from camcal.raw.level import Level

DECIBELS_A_STOP = 20 * log10(2)
FULL_WELL, WHITE_LEVEL, NOT_REACHED = "full well", "white level", "not reached"

_DRIFT = (0.01, 0.2)  # of the signal between frames of one level: what is warned of, what is refused
_SIGNIFICANT = 5.0  # standard deviations at which a difference is no chance
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
    _require_alike(flats, darks)
    _require_light(flats, darks)
    _require_steady(flats, darks)
    darks = sorted(darks, key=lambda level: level.exposure_s or 0.0)
    names, white = flats[0].names, min(level.white for level in flats)
    curves = {name: transfer_curve(flats, darks[0], phase) for phase, name in enumerate(names)}
    reached = {name for name, curve in curves.items() if curve.saturation is not None}
    phases = {name: figures_of(curve, phase, flats, darks, white) for phase, (name, curve) in enumerate(curves.items())}
    return Characterisation(
        size=flats[0].size,
        white=white,
        peak=max(level.peak for level in flats),
        figures=together(phases[name] for name in names if name in reached or not reached),
        phases=phases,
        curves=curves,
        saturation=_what_ends(curves, white),
        limited=any(curve.noise.limited for curve in curves.values()),
        warnings=tuple(_warnings(flats, darks, curves, phases, white)),
    )


def _require_alike(flats: Sequence[Level], darks: Sequence[Level]) -> None:
    for levels, kind in ((flats, "flat"), (darks, "dark")):
        if not levels:
            raise InsufficientData(f"no {kind} frames; photon transfer needs two flat and two dark frames at least")
    first = flats[0]
    for level in (*flats, *darks):
        if (level.size, level.names) != (first.size, first.names):
            sizes = " and ".join(f"{size[0]} × {size[1]}" for size in (first.size, level.size))
            raise InvalidInput(f"frames of {sizes}, or of two patterns: flat and dark frames must be alike")


def _require_light(flats: Sequence[Level], darks: Sequence[Level]) -> None:
    brightest, dark = max(level.mean_dn.mean() for level in flats), min(level.mean_dn.mean() for level in darks)
    if brightest < dark:
        raise InsufficientData(
            f"the flat frames are darker than the dark ones (mean {brightest:.4g} and {dark:.4g}): check --dark"
        )
    white, darkest = flats[0].white, min(level.mean_dn.min() for level in (*flats, *darks))
    if darkest >= white:
        raise InsufficientData(f"all counts are above the white level of {white:g}, {darkest:.4g} in the mean at least")


def _drifts(flats: Sequence[Level], darks: Sequence[Level]) -> Iterator[tuple[Level, float]]:
    """Yield the levels whose frames differ in brightness by more than chance, and by what share of their signal."""
    black = np.mean([level.mean_dn for level in darks], axis=0)
    for level in flats:
        signal = level.mean_dn - black
        change = np.ptp(level.frame_means, axis=0)
        sure = change > _SIGNIFICANT * np.sqrt(2 * level.temporal / level.samples)
        if (shares := change[sure & (signal > 0)] / signal[sure & (signal > 0)]).size:
            yield level, float(shares.max())


def _require_steady(flats: Sequence[Level], darks: Sequence[Level]) -> None:
    for level, share in _drifts(flats, darks):
        if share > _DRIFT[1]:
            raise InsufficientData(
                f"frames of one level ({_describe(level)}) differ by {100 * share:.0f} % in brightness: check for "
                "mixed exposures or flicker"
            )


def _describe(level: Level) -> str:
    exposure = "" if level.exposure_s is None else f"{1e3 * level.exposure_s:g} ms, "
    return f"{exposure}{level.frames} frames, mean {level.mean_dn.mean():.4g}"


def _what_ends(curves: Mapping[str, Curve], white: float) -> str:
    ends = [curve.saturation + curve.noise.mean for curve in curves.values() if curve.saturation is not None]
    if not ends:
        return NOT_REACHED
    return WHITE_LEVEL if max(ends) > white - 1 else FULL_WELL


def _warnings(
    flats: Sequence[Level],
    darks: Sequence[Level],
    curves: Mapping[str, Curve],
    phases: Mapping[str, Figures],
    white: float,
) -> Iterator[Message]:
    """Yield the warnings about the frames and the figures."""
    for level, share in _drifts(flats, darks):
        if share > _DRIFT[0]:
            text = f"illumination changed by {100 * share:.2g} % between frames of one level ({_describe(level)})"
            yield Message("unstable_illumination", text, {"change": share})
    if _what_ends(curves, white) == NOT_REACHED:
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
        if apart > _SIGNIFICANT * hypot(one.std, other.std) and apart > _SAME_GAIN * one.value:
            text = f"gains of {name} and {other_name} differ ({one.value:.4g} and {other.value:.4g} DN/e)"
            yield Message("gains_differ", text, {name: one.value, other_name: other.value})
            return
