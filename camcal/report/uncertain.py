"""A value and its standard deviation as text, rounded by its standard deviation."""

from collections.abc import Iterable, Mapping, Sequence
from math import floor, isfinite, log10
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # tables are shown by commands that import nothing heavy
    from camcal.quality.projection_uncertainty import KnownRegion
    from camcal.targets.board import Board

_FIGURES = {"rms": "RMS", "max": "worst", "centre": "centre", "median": "median", "p95": "95th percentile"}
_WHOLE = 0.995  # share of an image that is called all of it
_LEAST, _MOST = 1e-6, 1e5  # standard deviations outside of these are written with an exponent


def number_text(value: float, digits: int = 4) -> str:
    """Return a number of no known uncertainty to so many digits; below a million no digit before the point is lost."""
    if 10**digits <= abs(value) < 1e6:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def value_and_std(value: float, std: float | None) -> tuple[str, str]:
    """Return the standard deviation to two digits and the value to the same place.

    A std that is None (not known) or 0 leaves six digits of the value, and says nothing or 0.
    """
    if std is None or not isfinite(std) or std <= 0 or not isfinite(value):
        return f"{value:.6g}", "" if std is None else f"{std:.2g}"
    place = 1 - floor(log10(std))
    if _LEAST <= std < _MOST:
        places = max(0, place)
        return f"{value:z.{places}f}", f"{std:.{places}f}"
    known = round(value, place)
    digits = floor(log10(abs(known))) + place if known else 0
    return f"{known:.{max(0, digits)}e}" if known else "0", f"{std:.1e}"


def value_with_std(value: float, std: float | None) -> str:
    """Return a value with its standard deviation, such as '458.65 ± 0.41'; without it where that is not known."""
    return " ± ".join(filter(None, value_and_std(value, std)))


def length_unit(board: "Board") -> tuple[float, str]:
    """Return the factor that takes small lengths of a board to the unit that they are said in, and that unit."""
    return (1e3, "mm") if board.unit == "m" else (1.0, "squares")


def values_and_stds(values: Iterable[Any], stds: Iterable[Any]) -> tuple[str, str]:
    """Return the numbers of a vector and their standard deviations, each to the place where it is known."""
    pairs = [value_and_std(float(value), float(std)) for value, std in zip(values, stds, strict=True)]
    return " ".join(value for value, _ in pairs), " ".join(std for _, std in pairs)


def held_by_prior_words(names: Sequence[str]) -> str:
    """Return which coefficients their priors determine rather than the data."""
    listed = ", ".join(names)
    if len(names) == 1:
        return f"{listed} is determined by its prior, not by the data"
    return f"{listed} are determined by their priors, not by the data"


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


def region_words(region: "KnownRegion | None", camera: str = "") -> str:
    """Return what limits a verdict to a part of the image, "" where it holds for all of it or that is not known.

    camera: whose image it is, where there are several.
    """
    if region is None or region.share > _WHOLE:
        return ""
    image = f"the image of {camera}" if camera else "the image"
    return f" in {100 * region.share:.0f} % of {image} (projection uncertainty up to {region.limit_px:.2g} px)"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"
