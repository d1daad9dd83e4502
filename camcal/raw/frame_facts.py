"""Statistics of a raw frame: exposure per channel, bits used, the diagonal of the green samples.

Counts give away the bits they have where a file or an option says more. Both greens of a Bayer cell see the same light,
so on the right diagonal of the cell the two samples agree, and on the other one red meets blue. Red and blue cannot be
distinguished this way.

The samples are averaged over blocks, and what counts is how the differences of neighbouring blocks agree: colour
reaches over neighbours, noise does not. Their mean product therefore estimates the square of the difference without
the bias that noise gives to its magnitude.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.raw import PATTERNS
from camcal.raw.mosaic import Mosaic, channel_names, phases

BINS = 64
_ROWS = 64

_ORDER = ("R", "G", "Gr", "Gb", "B", "gray")
_CONTAINERS = frozenset({1023.0, 4095.0, 16383.0, 65535.0})  # white levels that say the type and nothing of the sensor
_SPARE = 4  # times the largest count: two bits that are never used
_FEWEST_BITS = 8
_WIDE = 65535
_NARROWER = (10, 12, 14)
_FEWEST_COUNTS = 8  # different ones, on a grid that chance does not make
_COARSE = 16  # a step whose multiples may be off by one: some writers fill the low bits

_BLOCK = 12  # pixels
_MOST_BLOCKS = 1 << 14  # 2.4 megapixels: more of them change nothing
_LEAST_BLOCKS = 48
_DIFFERENT = 0.03  # of the sum: the greens of a sensor differ by up to 6 %, in colour and with the angle of the light
_DISTINCT = 2.0  # photographs have 7 and more
_SIGNIFICANT = 8.0  # standard errors
_NEGLIGIBLE = 1e-3  # of the sum: what rounding and gradients leave between samples that agree
_DARK = 0.1  # of the mean light: below it a relative difference is mostly noise


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
    blacks = [float(frame.black[row.start, column.start]) for row, column in places]
    dark = sum(np.count_nonzero(part <= black) for part, black in zip(parts, blacks, strict=True))
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


def _histogram(samples: Array, white: float) -> Array:
    counts = np.zeros(BINS, dtype=np.int64)
    for start in range(0, len(samples), _ROWS):  # bins of all samples at once would take 16 bytes each
        bins = np.multiply(samples[start : start + _ROWS], np.float32(BINS / white), dtype=np.float32)
        counts += np.bincount(np.clip(bins, 0, BINS - 1).astype(np.uint8).ravel(), minlength=BINS)
    return counts


class Widened(NamedTuple):
    """Counts of fewer bits that were spread over 16: the bits, and the distance of two of them in the file."""

    bits: int
    step: float

    @property
    def white(self) -> float:
        """The largest count of so many bits."""
        return 2.0**self.bits - 1


def likely_white(peak: float, white: float) -> float | None:
    """Return the white level of so many bits as the largest count takes, None if the stated one may well be right.

    white: counts at saturation as a container of 10 to 16 bits has them; two bits of it are not used.
    """
    if white not in _CONTAINERS or not 0 < peak < (white + 1) / _SPARE:
        return None
    return 2.0 ** max(_FEWEST_BITS, int(peak).bit_length()) - 1


def low_peak(peak: float, white: float, likely: float) -> Message:
    """Return the warning about a largest count far below the stated white level; likely: of `likely_white`."""
    text = f"largest count {peak:g} of {white:g}: the white level may be {likely:g} (--white {likely:g})"
    return Message("low_peak", text, {"peak_dn": peak, "white_dn": white, "likely_white_dn": likely})


def used_counts(frame: Mosaic) -> Array:
    """Return which of 65536 counts a frame holds, bool; none of them unless its counts are said to have 16 bits."""
    if frame.values.dtype != np.uint16 or frame.white != _WIDE:
        return np.zeros(_WIDE + 1, bool)
    return np.bincount(frame.values.ravel(), minlength=_WIDE + 1) > 0


def widened(used: Iterable[Array]) -> Widened | None:
    """Return how counts of fewer bits became 16, by the counts that frames use; None if they did not.

    They were shifted (12 bits times 16) or scaled to the full range (times 65535 / 4095).
    """
    counts = np.flatnonzero(np.any(list(used), axis=0))
    if len(counts) < _FEWEST_COUNTS:
        return None
    for bits in _NARROWER:
        for step in (2.0 ** (16 - bits), _WIDE / (2.0**bits - 1)):
            off = np.abs(counts - np.rint(np.rint(counts / step) * step))
            if off.max() <= (1 if step >= _COARSE else 0):
                return Widened(bits, step)
    return None


@dataclass(frozen=True)
class GreenDiagonal:
    """The diagonal of the 2 × 2 cell that green stands on.

    main: true for the one from the top left (GRBG, GBRG), false for the other (RGGB, BGGR), None when the frame
    does not tell: too small, too dark, gray, or no Bayer mosaic. ratio: the difference along the diagonal of red and
    blue over the one of green, at least 1; the smaller one is taken two standard errors larger than it was found.
    alike: all four samples of the cell agree, as with a monochrome sensor or a gray scene in balanced light.
    """

    main: bool | None
    ratio: float
    alike: bool


_UNKNOWN = GreenDiagonal(main=None, ratio=1.0, alike=False)


def green_diagonal(values: Array, black: Array) -> GreenDiagonal:
    """Return the diagonal of the cell that green stands on, as far as the frame tells.

    values: (H, W) counts or linear light. black: (2, 2) in the same unit, what the four samples read without light.
    """
    means = _block_means(values, black)
    if means.size < 4 * _LEAST_BLOCKS or not means.mean() > 0:
        return _UNKNOWN
    main, other, row = (_products(means, *ends) for ends in (((0, 0), (1, 1)), ((0, 1), (1, 0)), ((0, 0), (0, 1))))
    alike = max(_at_most(main), _at_most(other), _at_most(row)) < _DIFFERENT**2
    large, small = (main, other) if main.mean() > other.mean() else (other, main)
    ratio = float(np.sqrt(max(large.mean() / max(_at_most(small), _NEGLIGIBLE**2), 1.0)))
    more = large - small
    certain = large.mean() > _DIFFERENT**2 and ratio > _DISTINCT
    certain = certain and more.mean() > _SIGNIFICANT * _standard_error(more)
    return GreenDiagonal(main=large is other if certain else None, ratio=ratio, alike=alike)


def check_phase(mosaic: Mosaic) -> GreenDiagonal | None:
    """Return where green stands in a Bayer mosaic, None for other sensors.

    Raises InvalidInput with the two patterns that are possible if green stands on the other diagonal for sure.
    """
    if mosaic.pattern not in PATTERNS:
        return None
    diagonal = green_diagonal(mosaic.values, mosaic.black)
    if diagonal.main not in (None, _green_on_main(mosaic.pattern)):
        likely = " or ".join(pattern for pattern in PATTERNS if _green_on_main(pattern) == diagonal.main)
        raise InvalidInput(
            f"green is on the other diagonal: pattern {likely}, not {mosaic.pattern}; --preview-patterns shows them"
        )
    return diagonal


def _green_on_main(pattern: str) -> bool:
    return pattern[0] == "G"


def _block_means(values: Array, black: Array) -> Array:
    """Return the mean light (2, 2, pairs of rows, 2, columns) of every sample of the cell, over blocks of the frame.

    The Hann window weighs even and odd pixels about the same centre, so that a gradient is no difference.
    """
    pairs, columns = values.shape[0] // (2 * _BLOCK), values.shape[1] // _BLOCK
    if pairs * columns == 0:
        return np.zeros((2, 2, 0, 2, 0), np.float32)
    step = -(-2 * pairs * columns // _MOST_BLOCKS)
    bands = values[: 2 * pairs * _BLOCK, : columns * _BLOCK].reshape(pairs, 2, _BLOCK, -1)[::step].astype(np.float32)
    window = np.sin(np.pi / _BLOCK * np.arange(_BLOCK)) ** 2
    weights = np.zeros((2, _BLOCK), np.float32)
    for parity in (0, 1):
        weights[parity, parity::2] = window[parity::2] / window[parity::2].sum()
    means = (weights @ bands).reshape(-1, 2, 2, columns, _BLOCK) @ weights.T
    return np.asarray(means.transpose(2, 4, 0, 1, 3) - np.asarray(black, np.float32)[:, :, None, None, None])


def _products(means: Array, one: tuple[int, int], two: tuple[int, int]) -> Array:
    """Return the relative difference of two samples of the cell, times that of a diagonal neighbour, for all pairs.

    Edges of a level target run through rows or columns of blocks; diagonal neighbours do not share them.
    """
    total = np.maximum(means[one] + means[two], 0) + _DARK * 2 * means.mean()
    upper, lower = np.moveaxis((means[one] - means[two]) / total, 1, 0).astype(np.float64)
    return np.stack([upper[:, :-1] * lower[:, 1:], upper[:, 1:] * lower[:, :-1]])


def _at_most(products: Array) -> float:
    return float(max(products.mean(), 0) + 2 * _standard_error(products))


def _standard_error(products: Array) -> float:
    return float(products.std() / np.sqrt(products.size))
