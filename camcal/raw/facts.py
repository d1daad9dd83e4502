"""What the counts of a raw frame say about its exposure, channel by channel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.raw.mosaic import Mosaic, channel_names, phases

BINS = 64

_ORDER = ("R", "G", "Gr", "Gb", "B", "gray")


@dataclass(frozen=True, eq=False)
class ChannelFacts:
    """The samples of one channel: R, Gr (in the rows of red), Gb, B; R, G, B of X-Trans; or gray.

    mean, least, most: counts, black level included. at_black, at_white: shares of the samples at or below the black
    level, and at or above the white level. histogram: (64,) samples in bins of equal width from 0 to the white level;
    those outside count in the first and the last.
    """

    name: str
    samples: int
    mean: float
    least: float
    most: float
    at_black: float
    at_white: float
    histogram: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "histogram", readonly(self.histogram, (BINS,), "histogram", np.int64))


def channel_facts(frame: Mosaic) -> tuple[ChannelFacts, ...]:
    """Return the facts of every channel, in the order R, Gr, Gb, B (or R, G, B, or gray)."""
    places = phases(frame.pattern)
    names = channel_names(frame.pattern)
    by_name = {name: [place for place, own in zip(places, names, strict=True) if own == name] for name in names}
    return tuple(_facts(frame, name, by_name[name]) for name in sorted(by_name, key=_ORDER.index))


def _facts(frame: Mosaic, name: str, places: Sequence[tuple[slice, slice]]) -> ChannelFacts:
    parts = [frame.values[place] for place in places]
    samples = sum(part.size for part in parts)
    dark = sum(np.count_nonzero(frame.values[row, column] <= _black(frame, row, column)) for row, column in places)
    bright = sum(np.count_nonzero(part >= frame.white) for part in parts)
    return ChannelFacts(
        name=name,
        samples=samples,
        mean=float(sum(part.sum(dtype=float) for part in parts)) / samples,
        least=float(min(part.min() for part in parts)),
        most=float(max(part.max() for part in parts)),
        at_black=float(dark) / samples,
        at_white=float(bright) / samples,
        histogram=np.sum([_histogram(part, frame.white) for part in parts], axis=0),
    )


def _black(frame: Mosaic, row: slice, column: slice) -> float:
    return float(frame.black[row.start, column.start])


def _histogram(samples: Array, white: float) -> Array:
    bins = np.multiply(samples, np.float32(BINS / white), dtype=np.float32)
    return np.bincount(np.clip(bins, 0, BINS - 1).astype(np.uint8).ravel(), minlength=BINS)
