"""What a value in a YAML document may be: checks that compose into the description of a whole file.

A check takes a value and its key path and yields a Fault for everything wrong with it. Checks only look; the data is
turned into records after all of them have passed.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from camcal.formats.documents import Check, Fault, child
from camcal.formats.emit import number_text
from camcal.parsing import LARGEST, did_you_mean, nearest, parse_number

VENDOR = "x_"
SMALLEST = 1e-12  # of one that has to be positive
LARGEST_STD = 1e50  # also of what is hardly known; its square is still a number
LARGEST_VARIANCE = LARGEST_STD**2
LARGEST_SIDE = 1_000_000  # px, of an image


def number(low: float = -LARGEST, high: float = LARGEST, *, positive: bool = False, hint: str = "") -> Check:
    """Return a check for a finite number in [low, high]; positive: at least SMALLEST, and `hint` is said of others."""
    low = max(low, SMALLEST) if positive else low

    def check(value: Any, path: str) -> Iterator[Fault]:
        if (text := _not_a_number(value)) is not None:
            yield Fault(path, text)
        elif positive and not value > 0:
            yield Fault(path, f"{value!r} must be > 0{hint}")
        elif not low <= value <= high:
            yield Fault(path, f"{value!r} is outside [{low:g}, {high:g}]")

    return check


def _not_a_number(value: Any) -> str | None:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return None if math.isfinite(value) else f"{'-' * (value < 0)}.{abs(value)} is not finite"
    try:
        plain = number_text(parse_number(value)) if isinstance(value, str) else ""
    except ValueError:
        plain = ""
    if plain:
        return f"{value!r} was read as text (YAML 1.1 needs {plain}, without quotes)"
    return f"{_shown(value)} is not a number"


def _shown(value: Any) -> str:
    if isinstance(value, (dict, list)):
        return "a mapping" if isinstance(value, dict) else "a list"
    if isinstance(value, bool):
        return "true" if value else "false"
    return "an empty value" if value is None else repr(value)


FINITE = number(-math.inf, math.inf)
STD = number(0, LARGEST_STD)
VARIANCE = number(-LARGEST_VARIANCE, LARGEST_VARIANCE)
FOCAL_LENGTH = number(1e-3, 1e10, positive=True, hint=" (mirrored image? flip the image instead)")  # px
STATISTIC = VARIANCE  # such as χ² or the condition of a matrix


def integer(low: int = -int(LARGEST), high: int = int(LARGEST)) -> Check:
    """Return a check for a whole number in [low, high]."""

    def check(value: Any, path: str) -> Iterator[Fault]:
        if not isinstance(value, int) or isinstance(value, bool):
            yield Fault(path, f"{_shown(value)} is not a whole number")
        elif value < low:
            yield Fault(path, f"{value} must be at least {low}")
        elif value > high:
            yield Fault(path, f"{value:.6g} must be at most {high}")

    return check


def text(value: Any, path: str) -> Iterator[Fault]:
    """Check for a text."""
    if not isinstance(value, str):
        yield Fault(path, f"{_shown(value)} is not text; put it in quotes")


def flag(value: Any, path: str) -> Iterator[Fault]:
    """Check for true or false."""
    if not isinstance(value, bool):
        yield Fault(path, f"{_shown(value)} is not true or false")


def plain(value: Any, path: str) -> Iterator[Fault]:
    """Check for any data that leaves no doubt: no empty values, no infinite numbers."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from plain(item, child(path, key))
    elif isinstance(value, list):
        yield from items(plain)(value, path)
    elif value is None:
        yield Fault(path, "an empty value; leave the key out")
    elif isinstance(value, float):
        yield from FINITE(value, path)


def unchecked(_value: Any, _path: str) -> Iterator[Fault]:
    """Pass anything: it may be anything, or is checked with what it depends on."""
    return iter(())


def one_of(names: Sequence[str], what: str) -> Check:
    """Return a check for one of a few names."""

    def check(value: Any, path: str) -> Iterator[Fault]:
        if value not in names:
            yield Fault(path, f"unknown {what} {_shown(value)}{did_you_mean(str(value), names)}")

    return check


def items(check: Check, *lengths: int) -> Check:
    """Return a check for a list whose items all pass `check`, of one of the given lengths (none given: any)."""

    def check_items(value: Any, path: str) -> Iterator[Fault]:
        if not isinstance(value, list):
            yield Fault(path, f"{_shown(value)} is not a list")
        elif lengths and len(value) not in lengths:
            yield Fault(path, f"{len(value)} items; {' or '.join(map(str, lengths))} are needed")
        else:
            for index, item in enumerate(value):
                yield from check(item, child(path, index))

    return check_items


def matrix(rows: int, columns: int, check: Check | None = None) -> Check:
    """Return a check for a list of `rows` lists of `columns` numbers, which pass `check`."""
    return items(items(check or number(), columns), rows)


COVARIANCE_OF_POSE = matrix(6, 6, VARIANCE)


def mapping(
    required: Mapping[str, Check], optional: Mapping[str, Check] | None = None, *, others: Check | None = None
) -> Check:
    """Return a check for a mapping of the given keys.

    others: the check of keys not named; without it they are faults, save x_ keys, which may hold any plain data.
    """
    known = {**required, **(optional or {})}

    def check(value: Any, path: str) -> Iterator[Fault]:
        if not isinstance(value, dict):
            yield Fault(path, f"{_shown(value)} is not a mapping of keys to values")
            return
        free = [name for name in known if name not in value]
        misspelt: set[str | None] = set()
        for key, item in value.items():
            rule = known.get(key) or (plain if key.startswith(VENDOR) else others)
            if rule is None:
                misspelt.add(nearest(key, free))  # then this one is not missing as well
                yield Fault(child(path, key), f"unknown key{did_you_mean(key, free or list(known))}")
            else:
                yield from rule(item, child(path, key))
        missing = [name for name in required if name not in value and name not in misspelt]
        yield from (Fault(path, f"missing key {name!r}") for name in missing)

    return check
