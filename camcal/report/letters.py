"""The letters that figures in text are made of: blocks where the encoding of a terminal has them, ASCII otherwise.

A histogram of any values is made of them here; the figures of a calibration are in `text_figures`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

_BINS = 8
_WIDEST = 60
_DIGITS = 3


@dataclass(frozen=True)
class Letters:
    """Levels of gray, parts of a bar and of a column from empty to full, the frame, and other marks.

    frame: corners from the top left in reading order, a horizontal and a vertical line.
    """

    grays: str
    bar: str
    column: str
    frame: str
    expected: str
    outside: str = "/"


BLOCKS = Letters(" ░▒▓█", " ▏▎▍▌▋▊▉█", " ▁▂▃▄▅▆▇█", "┌┐└┘─│", "│")
ASCII = Letters(" .:o#", " #", " .:-=+*%#", "++++-|", "|")


def letters(encoding: str | None) -> Letters:
    """Return the letters for a stream of an encoding."""
    try:
        f"{BLOCKS.grays}{BLOCKS.bar}{BLOCKS.column}{BLOCKS.frame}".encode(encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return ASCII
    return BLOCKS


def value_histogram(values: Sequence[float], title: str, width: int, encoding: str | None) -> list[str]:
    """Return a title and a bar with the count for each of some equal ranges of values, in at most `width` letters."""
    drawn = letters(encoding)
    counts, ends = np.histogram(values, min(_BINS, max(1, len(set(values)))))
    names = [f"{low:.{_DIGITS}g} to {high:.{_DIGITS}g}" for low, high in pairwise(ends)]
    label, digits = max(map(len, names)), len(str(counts.max()))
    longest = min(width, _WIDEST) - label - digits - 2
    lines = []
    for name, count in zip(names, counts.tolist(), strict=True):
        full, rest = divmod(round(count / counts.max() * longest * (len(drawn.bar) - 1)), len(drawn.bar) - 1)
        bar = drawn.bar[-1] * full + (drawn.bar[rest] if rest else "")
        lines.append(f"{name:>{label}} {count:>{digits}} {bar}".rstrip())
    return [title[:width], *lines]
