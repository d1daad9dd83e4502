"""Numbers in texts, as every other program writes them: Python alone also takes 1_000 and the digits of all scripts."""

from collections.abc import Iterable

_LONGEST = 400  # characters: no number that means anything has more


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


def _require_plain(text: str) -> None:
    if not text.isascii() or "_" in text or len(text) > _LONGEST:
        raise ValueError(f"{text[:40]!r} is not a number")
