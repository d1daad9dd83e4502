"""Malvar's filters against the kernels as the paper prints them, one convolution for each colour and place."""

import numpy as np
import pytest
from bayer import PEAK, by_threads, random_mosaic, sampled, scene

from camcal.raw import PATTERNS
from camcal.raw.filters import malvar

GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8
IN_ROW = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8
OPPOSITE = (
    np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8
)


def convolved(mosaic, kernel):
    mirrored = np.pad(mosaic.astype(float), 2, mode="reflect")
    return sum(
        kernel[row, column] * mirrored[row : row + mosaic.shape[0], column : column + mosaic.shape[1]]
        for row, column in np.argwhere(kernel)
    )


def by_the_paper(mosaic, pattern):
    """Return colour (H, W, 3) blue, green, red, neither rounded nor cut off."""
    results = {kernel: convolved(mosaic, values) for kernel, values in (("green", GREEN), ("opposite", OPPOSITE))}
    results |= {"row": convolved(mosaic, IN_ROW), "column": convolved(mosaic, IN_ROW.T), "own": mosaic}
    colour = np.empty((*mosaic.shape, 3))
    for place, letter in enumerate(pattern):
        site = slice(place // 2, None, 2), slice(place % 2, None, 2)
        beside = pattern[place ^ 1]  # the other letter in this row of the cell
        for channel, wanted in enumerate("BGR"):
            if wanted == letter:
                source = "own"
            elif wanted == "G":
                source = "green"
            elif letter == "G":
                source = "row" if wanted == beside else "column"
            else:
                source = "opposite"
            colour[(*site, channel)] = results[source][site]
    return colour


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("dtype", PEAK)
@pytest.mark.parametrize("shape", [(6, 8), (9, 8), (8, 13), (31, 47)])
def test_every_colour_is_the_published_convolution(pattern, dtype, shape):
    mosaic = random_mosaic(shape, dtype)
    result = malvar(mosaic, pattern, PEAK[dtype])
    if dtype == np.float32:
        expected, tolerance = np.minimum(by_the_paper(mosaic, pattern), 1), 1e-6  # a dozen sums of numbers up to 1
    else:
        expected, tolerance = np.clip(by_the_paper(mosaic, pattern), 0, PEAK[dtype]), 0.51  # rounded
    np.testing.assert_allclose(result, expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("dtype", PEAK)
@pytest.mark.parametrize("tile", [(2, 2), (8, 6), (10, 40)])
def test_tiles_and_threads_change_no_bit(dtype, tile):
    mosaic = sampled((scene((31, 76)) * PEAK[dtype]).astype(dtype), "GBRG")
    whole = malvar(mosaic, "GBRG", PEAK[dtype])
    np.testing.assert_array_equal(malvar(mosaic, "GBRG", PEAK[dtype], tile=tile), whole)
    np.testing.assert_array_equal(malvar(mosaic, "GBRG", PEAK[dtype], tile=tile, each=by_threads), whole)


def test_sixteen_bits_end_at_white_and_at_zero():
    mosaic = np.random.default_rng(2).integers(0, 2, (20, 20)).astype(np.uint16) * np.uint16(4095)
    result = malvar(mosaic, "RGGB", 4095)
    expected = by_the_paper(mosaic, "RGGB")
    assert expected.max() > 5000  # the filters overshoot at such edges
    assert expected.min() < -1000
    np.testing.assert_allclose(result, np.clip(expected, 0, 4095), rtol=0, atol=0.51)  # rounded
