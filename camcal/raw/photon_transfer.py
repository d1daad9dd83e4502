"""The photon transfer curve of one phase of the filter: how noise grows with light, and where it ends.

Photons arrive by chance, so their variance is their number: of counts above black x the variance is K x + σ², where K
is the gain in counts per electron. Source: EMVA 1288 Release 4.0 Linear (noise model; photon transfer method).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import InsufficientData
from camcal.raw.counting import ROUNDING, Noise, before_counting
from camcal.raw.level import Level

_FITTED = 0.7  # of the signal of the largest variance: as EMVA 1288 has it
_CLIPPED = 1e-3  # share of samples at 0 or at white that makes a level useless for its variance
_SATURATED = 0.35  # of the variance expected: where a clipped Gaussian is half full, within 0.4 σ of its limit
_COMPLETE = 0.9  # of the variance expected: nothing was cut off
_ROUNDS = 3  # of weighting by the variance that the fit before expects


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
    noise: Noise
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


def _fit(signal: Array, variance: Array, degrees: Array, noise: Noise) -> tuple[Figure, float]:
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
            "the noise of the flat frames does not grow with their light: they are saturated, too dark or not raw"
        )
    residual = (y - design @ (gain, intercept)) / std
    excess = np.square(residual).sum() / max(len(x) - 2, 1)
    return Figure(float(gain), float(error * np.sqrt(max(excess, 1.0)))), float(intercept)
