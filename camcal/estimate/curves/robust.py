"""Losses for data with outliers: their tuning, the scale of the residuals, and the covariance that follows."""

from collections.abc import Callable, Mapping

import numpy as np

from camcal.arrays import Array
from camcal.solve.losses import Cauchy, Huber, Loss, SoftL1, Tukey

# Loss of each name, at 95 % of the efficiency of least squares for normal errors (computed from its ψ).
LOSSES: Mapping[str, tuple[Callable[[float], Loss], float]] = {
    "huber": (Huber, 1.345),
    "soft_l1": (SoftL1, 1.287),
    "cauchy": (Cauchy, 2.385),
    "tukey": (Tukey, 4.685),
}
_MEDIAN = {1: 0.6744897501960817, 2: 1.1774100225154747}  # of the length of a normal vector of so many components
_SMALL = 1e-4


def loss_named(name: str, scale: float) -> Loss | None:
    """Return the loss of a name for residuals of standard deviation `scale`, None for least squares ('none')."""
    if name == "none":
        return None
    kind, tuning = LOSSES[name]
    return kind(tuning * scale)


def spread(residuals: Array, freedom: int, parameters: int) -> float:
    """Return the standard deviation of residuals (N, D) by the median of their lengths, which outliers hardly move.

    freedom: how many of the D components are independent. parameters: how many the residuals were fitted by.
    """
    count = len(residuals) * freedom
    lengths = np.linalg.norm(residuals, axis=1)
    correction = np.sqrt(count / max(count - parameters, 1))
    return float(np.median(lengths) / _MEDIAN[freedom] * correction)


def covariance_factor(loss: Loss, squared: Array, freedom: int, parameters: int) -> float:
    """Return what (JᵀJ)⁻¹ of unweighted residuals is to be multiplied by to be the covariance of a robust fit.

    squared: (N,) squared lengths of the residuals. With ψ(r) = ρ'(r²) r it is E[ψ²] / E[ψ']², corrected for the
    number of parameters. Source: Huber, Robust Statistics, 1981, equations 6.5 and 7.6.
    """
    weights = loss.weight(squared)
    higher, lower = squared * (1 + _SMALL), squared * (1 - _SMALL)
    bend = (loss.weight(higher) - loss.weight(lower)) / (2 * _SMALL)  # s dρ'/ds
    slopes = weights + 2 * bend / freedom
    count = len(squared) * freedom
    power = float(np.sum(weights**2 * squared)) / max(count - parameters, 1)
    mean = float(np.mean(slopes))
    correction = 1 + parameters / count * float(np.var(slopes)) / mean**2
    return correction**2 * power / mean**2
