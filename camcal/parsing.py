"""Texts of users: numbers, names of files, and suggestions for misspelt names.

Numbers are taken as every other program writes them: Python alone also takes 1_000 and the digits of all scripts.
"""

from collections.abc import Iterable
from difflib import get_close_matches

LARGEST = 1e12  # of a number in a file that nothing else limits: squares of squares of more are no numbers any longer
_LONGEST = 400  # characters: no number that means anything has more
_FEW = 24  # names that a message lists
_LINE_BREAKS = {ord(letter): repr(letter)[1:-1] for letter in "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"}


def parse_number(text: str) -> float:
    """Return the number in a text, which may be inf or nan; raises ValueError if it is none."""
    _require_plain(text)
    return float(text)


def parse_integer(text: str) -> int:
    """Return the whole number in a text; raises ValueError if it is none."""
    _require_plain(text)
    return int(text)


def parse_numbers(texts: Iterable[str]) -> list[float]:
    """Return the numbers in texts; raises ValueError if one of them is none."""
    return [parse_number(text) for text in texts]


def is_number(text: str) -> bool:
    """Return whether a text is a number."""
    try:
        parse_number(text)
    except ValueError:
        return False
    return True


def nearest(name: str, known: Iterable[str], likeness: float = 0.6) -> str | None:
    """Return the known name that a misspelt one most likely stands for; likeness: how alike they must be, up to 1."""
    lowered = {each.lower(): each for each in known}
    return next((lowered[each] for each in get_close_matches(name.lower(), lowered, n=1, cutoff=likeness)), None)


def did_you_mean(name: str, known: Iterable[str], otherwise: str | None = None) -> str:
    """Return the end of a message about an unknown name: the nearest known one, or all of them if they are few.

    otherwise: what to say in place of all names.
    """
    known = list(known)
    if (match := nearest(name, known)) is not None:
        return f". Did you mean {match!r}?"
    if otherwise is None and 0 < len(known) <= _FEW:
        return f"; possible here: {', '.join(known)}"
    return otherwise or ""


def _require_plain(text: str) -> None:
    if not text.isascii() or "_" in text or len(text) > _LONGEST:
        raise ValueError(f"{text[:40]!r} is not a number")


def in_one_line(text: str) -> str:
    """Return a name with its line breaks written as escapes, so that a message about it keeps to its line."""
    return text.translate(_LINE_BREAKS)


def parse_size(text: str) -> tuple[int, int]:
    """Return (width, height) from a size written as 1920x1080; raises ValueError for anything else."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(text)
    size = parse_integer(width), parse_integer(height)
    if not all(size):
        raise ValueError(text)
    return size


def parse_crop(text: str) -> tuple[int, int, int, int]:
    """Return (width, height, x, y) from a part written as 640x480+10+20; raises ValueError for anything else."""
    size, *corner = text.split("+")
    if len(corner) != 2 or not all(each.isdecimal() for each in corner):
        raise ValueError(text)
    return (*parse_size(size), parse_integer(corner[0]), parse_integer(corner[1]))
