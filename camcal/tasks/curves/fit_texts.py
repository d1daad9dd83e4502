"""What the options of `camcal fit` say in text: starts, bounds, fixed parameters."""

import math
from collections.abc import Mapping

from camcal.errors import InvalidInput
from camcal.parsing import parse_number


def starts(text: str | None, option: str = "--start") -> dict[str, float]:
    """Return the values of a text such as a=2,b=-1 by name; raises InvalidInput, naming the option, for others."""
    found: dict[str, float] = {}
    for part in _parts(text):
        name, equals, value = part.partition("=")
        if not equals or not name.strip():
            raise InvalidInput(f"{option} {part!r}: write NAME=VALUE, several with commas, such as a=2,b=-1")
        _once(found, name.strip(), option)
        found[name.strip()] = _number(value, option, part)
    return found


def fixed(text: str | None) -> tuple[frozenset[str], dict[str, float]]:
    """Return the names of a text such as a,b=3, and the values of those that have one."""
    names: dict[str, float] = {}
    values = {}
    for part in _parts(text):
        name, equals, value = part.partition("=")
        _once(names, name.strip(), "--fix")
        names[name.strip()] = 0.0
        if equals:
            values[name.strip()] = _number(value, "--fix", part)
    return frozenset(names), values


def bounds(text: str | None) -> dict[str, tuple[float, float]]:
    """Return the bounds of a text such as a=0:10,b=:5, where an end left out is open."""
    found: dict[str, tuple[float, float]] = {}
    for part in _parts(text):
        name, equals, ends = part.partition("=")
        low, colon, high = ends.partition(":")
        if not equals or not colon:
            raise InvalidInput(f"--bounds {part!r}: write NAME=LOW:HIGH, such as a=0:10, or a=0: for one end")
        _once(found, name.strip(), "--bounds")
        least = _number(low, "--bounds", part) if low.strip() else -math.inf
        greatest = _number(high, "--bounds", part) if high.strip() else math.inf
        if not least < greatest:
            raise InvalidInput(f"--bounds {part!r}: {least:g} is not below {greatest:g}; --fix holds a parameter")
        found[name.strip()] = least, greatest
    return found


def _parts(text: str | None) -> list[str]:
    return [] if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _once(found: Mapping[str, object], name: str, option: str) -> None:
    if name in found:
        raise InvalidInput(f"{option}: {name!r} stands twice")


def _number(text: str, option: str, part: str) -> float:
    try:
        value = parse_number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InvalidInput(f"{option} {part!r}: {text.strip()!r} is not a number")
    return value
