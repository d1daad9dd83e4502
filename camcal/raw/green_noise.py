"""How noisy the green samples of a mosaic are, told by the mosaic itself.

Second differences along both diagonals leave nothing of a plane, and little of anything smooth. The least of their
mean squares over blocks is that of a block without detail: it is noise. Blocks whose samples are cut off at black or
at white say too little.
Source: J. Immerkær, Fast Noise Variance Estimation, CVIU 1996 (the filter, here on the diagonal grid of green).
"""

import numpy as np

from camcal.arrays import Array
from camcal.raw.scales import WHITE

_BLOCK = 6  # cells a side
_MOST_BANDS = 64  # rows of blocks: more of them change nothing
_SMALL = 0.05  # share of the blocks that are taken for smooth
_CUT_OFF = 0.02  # share of the samples of a block
_TOP = WHITE - 0.01
_SMALLEST = 4.0  # variance that is never counted: fine texture and the rounding of 8 bits
_GAIN = 36.0  # variance of the filter's result, in that of the samples


def noise_of_green(green: tuple[Array, Array]) -> float:
    """Return the variance of the noise of green samples beyond what is negligible, in the filters' numbers.

    green: two planes (rows, columns), at the right and at the bottom of red. A frame without a whole block has none.
    """
    right, below = green
    if min(right.shape) < _BLOCK + 2:
        return 0.0
    variances, cut_off = _blocks(right, below)
    usable = variances[cut_off <= _CUT_OFF] if (cut_off <= _CUT_OFF).any() else variances
    return max(float(np.quantile(usable, _SMALL, method="lower")) - _SMALLEST, 0.0)


def _blocks(right: Array, below: Array) -> tuple[Array, Array]:
    """Return the mean square of the second differences of every block, and the share of samples that are cut off."""
    rows, columns = ((length - 2) // _BLOCK for length in right.shape)
    chosen = range(0, rows, -(-rows // _MOST_BANDS))
    variances, cut_off = np.empty((len(chosen), columns)), np.empty((len(chosen), columns))
    for place, row in enumerate(chosen):
        band = slice(row * _BLOCK, (row + 1) * _BLOCK + 2), slice(0, columns * _BLOCK + 2)
        middle = right[band][1:-1, 1:-1]
        variances[place] = _block_means(np.square(_second_difference(right[band], below[band])) / _GAIN)
        cut_off[place] = _block_means((middle == 0) | (middle >= _TOP))
    return variances, cut_off


def _second_difference(right: Array, below: Array) -> Array:
    """Return the second difference along both diagonals of the mosaic at the inner samples to the right of red."""
    corners = below[1:-1, 1:-1] + below[1:-1, 2:] + below[:-2, 1:-1] + below[:-2, 2:]
    beyond = right[:-2, 1:-1] + right[2:, 1:-1] + right[1:-1, :-2] + right[1:-1, 2:]
    return np.asarray(4 * right[1:-1, 1:-1] - 2 * corners + beyond)


def _block_means(band: Array) -> Array:
    return np.asarray(band.reshape(_BLOCK, -1, _BLOCK).mean(axis=(0, 2), dtype=np.float64))
