"""A value and its standard deviation as text, no digit more than is known."""

from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10

_FIGURES = {"rms": "RMS", "max": "worst", "centre": "centre", "median": "median", "p95": "95th percentile"}


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


def projection_words(figures: Mapping[str, float], range_m: float | None = None) -> str:
    """Return figures of a projection uncertainty by their keys in a camera file, px, as a line."""
    distance = "at infinity" if range_m is None else f"at {range_m:g} m"
    image, inside = (
        ", ".join(
            f"{words} {_two_digits(figures[key])} px"
            for name, words in _FIGURES.items()
            if (key := f"{part}{name}_px") in figures
        )
        for part in ("", "inside_")
    )
    parts = [image] if image else []
    parts += [f"where corners were seen: {inside}"] if inside else []
    return f"Projection uncertainty (1 sigma, {distance}): {'; '.join(parts)}"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"
