"""Vertices as rows of text; nine significant digits are all that a float32 holds."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError

_ROWS = 1 << 12  # turned into text at a time: Python's numbers take ten times the room of the array's
_NUMBER = {"f": "%.9g", "u": "%d"}


def rows(blocks: Iterable[Array]) -> Iterator[bytes]:
    """Yield structured arrays (N,) as lines of numbers with blanks between them."""
    for block in blocks:
        row = " ".join(_NUMBER[block.dtype[name].kind] for name in block.dtype.names or ()) + "\n"
        for start in range(0, len(block), _ROWS):
            part = block[start : start + _ROWS].tolist()
            yield (row * len(part) % tuple(chain.from_iterable(part))).encode("ascii")


def table(lines: Sequence[str], kind: np.dtype[np.void]) -> Array:
    """Return lines of text as a structured array (N,) of the type `kind`.

    Raises FileError naming what was expected and found.
    """
    names = kind.names or ()
    found = np.empty(len(lines), kind)
    with np.errstate(invalid="ignore", over="ignore"):
        for name, column in zip(names, numbers_in(lines, len(names)).T, strict=True):
            found[name] = column
    return found


def numbers_in(lines: Sequence[str], columns: int | None = None) -> Array:
    """Return the numbers of lines of text, (N, columns) float64; None for as many columns as there are.

    Raises FileError if they are no table, or one of another width.
    """
    if not lines:
        return np.empty((0, columns or 0))
    try:
        found: Array = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise FileError(f"the rows of vertices are no table of numbers: {error}") from error
    if columns not in {None, found.shape[1]}:
        raise FileError(f"a vertex has {columns} numbers by the header, a row has {found.shape[1]}")
    return found
