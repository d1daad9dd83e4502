"""A histogram of values in letters, for a terminal."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from camcal.report.letters import letters

_BINS = 8
_WIDEST = 60
_DIGITS = 3


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
