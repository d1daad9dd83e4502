"""A value and its standard deviation as text, no digit more than is known."""

from collections.abc import Sequence
from math import floor, isfinite, log10


def value_and_std(value: float, std: float | None) -> tuple[str, str]:
    """Return the standard deviation to two digits and the value to the same place.

    A std that is None (not known) or 0 leaves six digits of the value, and says nothing or 0.
    """
    if std is None or not isfinite(std) or std <= 0:
        return f"{value:.6g}", "" if std is None else f"{std:g}"
    if std >= 1e5 or std < 1e-6:
        return f"{value:.6g}", f"{std:.1e}"
    places = max(0, 1 - floor(log10(std)))
    return f"{value:.{places}f}", f"{std:.{places}f}"


def held_by_prior_words(names: Sequence[str]) -> str:
    """Return which coefficients their priors determine rather than the data."""
    listed = ", ".join(names)
    if len(names) == 1:
        return f"{listed} is held by its prior: the data hardly determine it"
    return f"{listed} are held by their priors: the data hardly determine them"
