"""Where the green samples stand, told by the frame itself.

Both greens of a Bayer cell see the same light, so on the right diagonal of the cell the two samples agree, and on the
other one red meets blue. Red and blue cannot be told apart this way.

The samples are averaged over blocks, and what counts is how the differences of neighbouring blocks agree: colour
reaches over neighbours, noise does not. Their mean product therefore estimates the square of the difference without
the bias that noise gives to its magnitude.
"""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import PATTERNS

_BLOCK = 12  # pixels
_MOST_BLOCKS = 1 << 14  # 2.4 megapixels: more of them change nothing
_LEAST_BLOCKS = 48
_DIFFERENT = 0.03  # of the sum: the greens of a sensor differ by up to 6 %, in colour and with the angle of the light
_DISTINCT = 2.0  # photographs have 7 and more
_SIGNIFICANT = 8.0  # standard errors
_NEGLIGIBLE = 1e-3  # of the sum: what rounding and gradients leave between samples that agree
_DARK = 0.1  # of the mean light: below it a relative difference is mostly noise


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
    certain = large.mean() > _DIFFERENT**2 and ratio > _DISTINCT and _significant(large - small)
    return GreenDiagonal(main=large is other if certain else None, ratio=ratio, alike=alike)


def check_phase(mosaic: Mosaic) -> GreenDiagonal | None:
    """Return where green stands in a Bayer mosaic, None for other sensors.

    Raises InvalidInput with the two patterns that are possible if green stands on the other diagonal for sure.
    """
    if mosaic.pattern not in PATTERNS:
        return None
    found = green_diagonal(mosaic.values, mosaic.black)
    if found.main not in (None, _green_on_main(mosaic.pattern)):
        likely = " or ".join(pattern for pattern in PATTERNS if _green_on_main(pattern) == found.main)
        raise InvalidInput(
            f"the greens are on the other diagonal: it is {likely}, not {mosaic.pattern}; --preview-patterns shows them"
        )
    return found


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


def _significant(products: Array) -> bool:
    return bool(products.mean() > _SIGNIFICANT * _standard_error(products))


def _standard_error(products: Array) -> float:
    return float(products.std() / np.sqrt(products.size))
