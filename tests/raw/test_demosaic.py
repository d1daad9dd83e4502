"""The bilinear filter, against its definition written out pixel by pixel, and its behaviour at the border."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw.demosaic import ALGORITHMS, demosaic
from camcal.raw.mosaic import PATTERNS, sites

SIZES = [(2, 2), (2, 3), (3, 2), (3, 3), (6, 8), (7, 8), (6, 9), (21, 35)]
PEAK = {np.uint8: 255, np.uint16: 65535, np.float32: 1}


def random_mosaic(shape, dtype, seed=5):
    return (np.random.default_rng(seed).random(shape) * PEAK[dtype]).astype(dtype)


def sampled(colour_image, pattern):
    """Return the mosaic that a sensor behind the pattern makes of (H, W, 3) blue, green, red."""
    mosaic = np.empty(colour_image.shape[:2], colour_image.dtype)
    for channel, colour in enumerate("BGR"):
        for site in sites(pattern, colour):
            mosaic[site] = colour_image[..., channel][site]
    return mosaic


def mean_of_neighbours(mosaic, pattern, row, column, colour):
    """Return the mean of the nearest samples of a colour: itself, else those of the mirrored 3 × 3 window."""
    height, width = mosaic.shape

    def letter(r, c):
        return pattern[r % 2 * 2 + c % 2]

    if letter(row, column) == colour:
        return float(mosaic[row, column])
    samples = []
    for r in (row - 1, row, row + 1):
        for c in (column - 1, column, column + 1):
            if letter(r, c) == colour:
                inside_r, inside_c = height - 1 - abs(height - 1 - abs(r)), width - 1 - abs(width - 1 - abs(c))
                samples.append(float(mosaic[inside_r, inside_c]))
    return sum(samples) / len(samples)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("dtype", PEAK)
def test_every_missing_colour_is_the_mean_of_its_nearest_samples(pattern, shape, dtype):
    mosaic = random_mosaic(shape, dtype)
    expected = [
        [[mean_of_neighbours(mosaic, pattern, row, column, c) for c in "BGR"] for column in range(shape[1])]
        for row in range(shape[0])
    ]
    # integers round to the nearest; float32 sums of four carry a few units in the last place
    tolerance = 0.5 if dtype != np.float32 else 1e-6
    result = demosaic(mosaic, pattern)
    assert result.dtype == dtype
    np.testing.assert_allclose(result.astype(float), expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("dtype", PEAK)
def test_a_plain_colour_comes_back_everywhere_up_to_the_border(pattern, dtype):
    colour = (np.array([0.8, 0.2, 0.6]) * PEAK[dtype]).astype(dtype)
    image = np.broadcast_to(colour, (7, 9, 3))
    np.testing.assert_array_equal(demosaic(sampled(image, pattern), pattern), image)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_samples_themselves_are_untouched(pattern):
    image = np.random.default_rng(2).integers(0, 65536, (8, 11, 3)).astype(np.uint16)
    result = demosaic(sampled(image, pattern), pattern)
    np.testing.assert_array_equal(sampled(result, pattern), sampled(image, pattern))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_full_scale_does_not_overflow(dtype):
    mosaic = np.full((6, 6), PEAK[dtype], dtype)
    assert (demosaic(mosaic, "RGGB") == PEAK[dtype]).all()


def test_a_linear_ramp_is_exact_inside():
    ramp = np.add.outer(np.arange(12), np.arange(9))[..., None] + np.zeros(3)
    result = demosaic(sampled(ramp.astype(np.float32), "RGGB"), "RGGB")
    np.testing.assert_allclose(
        result[1:-1, 1:-1], ramp[1:-1, 1:-1], rtol=0, atol=1e-5
    )  # float32 sums of numbers up to 20


def test_none_gives_the_mosaic_itself():
    mosaic = random_mosaic((5, 6), np.uint16)
    np.testing.assert_array_equal(demosaic(mosaic, "BGGR", "none"), mosaic)


def test_an_algorithm_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(InvalidInput, match=", ".join(ALGORITHMS)):
        demosaic(random_mosaic((4, 4), np.uint8), "RGGB", "magic")


@pytest.mark.parametrize("shape", [(1, 8), (8, 1), (4, 4, 3), (0, 0)])
def test_an_array_without_a_whole_cell_is_refused(shape):
    with pytest.raises(InvalidInput, match="2 × 2"):
        demosaic(np.zeros(shape, np.uint8), "RGGB")


def test_an_unknown_pattern_is_refused():
    with pytest.raises(InvalidInput, match="'RGB'"):
        demosaic(random_mosaic((4, 4), np.uint8), "RGB")
