"""What every way of demosaicing has in common, and the simple ones against their definitions.

How good the colours are is measured on real images; see tests/real.
"""

from itertools import product

import numpy as np
import pytest
from bayer import PEAK, by_threads, plain_colour, random_mosaic, sampled, scene
from hypothesis import given
from hypothesis import strategies as st

from camcal.errors import InvalidInput
from camcal.raw import MONO, PATTERNS
from camcal.raw.demosaic import ALGORITHMS, demosaic, require_algorithm
from camcal.raw.mosaic import sites

SIZES = [(2, 2), (2, 3), (3, 2), (3, 3), (6, 8), (7, 8), (6, 9), (21, 35)]
COLOUR = ("auto", "ri", "malvar", "bilinear", "ea", "vng")
# Red and blue of X-Trans stand where green does not; 36 letters in reading order.
X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"

every_pattern = pytest.mark.parametrize("pattern", PATTERNS)
every_type = pytest.mark.parametrize("dtype", PEAK)
every_colour_filter = pytest.mark.parametrize("algorithm", COLOUR)


def rounding(algorithm, dtype):
    """Return how far a number of floating point, full scale 1, may be from the sample that it was; integers come back.

    Square roots and their squares round a few times; the edge-aware filter goes through 16 bits.
    """
    if dtype != np.float32:
        return 0
    return 0.51 / 65535 if algorithm == "ea" else 1e-6


def test_every_algorithm_with_colour_is_in_these_tests():
    assert set(COLOUR) | {"half", "green", "gray", "none"} == set(ALGORITHMS)


@every_colour_filter
@every_pattern
def test_a_plain_colour_comes_back_everywhere_up_to_the_border(algorithm, pattern):
    for shape, dtype in product([(2, 2), (3, 2), (8, 12), (7, 12), (8, 11), (33, 35)], PEAK):
        image = plain_colour(shape, dtype)
        result = demosaic(sampled(image, pattern), pattern, algorithm)
        assert (result.shape, result.dtype) == ((*shape, 3), dtype)
        np.testing.assert_allclose(result, image, rtol=0, atol=rounding(algorithm, dtype), err_msg=str((shape, dtype)))


@every_colour_filter
@every_pattern
def test_the_samples_themselves_come_back(algorithm, pattern):
    for dtype, linear in product(PEAK, [False, True]):
        mosaic = random_mosaic((19, 22), dtype)
        result = sampled(demosaic(mosaic, pattern, algorithm, linear=linear), pattern)
        atol = rounding(algorithm, dtype)
        np.testing.assert_allclose(result, mosaic, rtol=0, atol=atol, err_msg=str((dtype, linear)))


@given(
    height=st.integers(2, 12),
    width=st.integers(2, 12),
    pattern=st.sampled_from(PATTERNS),
    algorithm=st.sampled_from(COLOUR),
    dtype=st.sampled_from(list(PEAK)),
    seed=st.integers(0, 2**32),
)
def test_the_smallest_mosaics_have_colour_as_well(height, width, pattern, algorithm, dtype, seed):
    mosaic = random_mosaic((height, width), dtype, seed)
    result = demosaic(mosaic, pattern, algorithm)
    assert (result.shape, result.dtype) == ((height, width, 3), dtype)
    np.testing.assert_allclose(sampled(result, pattern), mosaic, rtol=0, atol=rounding(algorithm, dtype))
    assert np.isfinite(result).all()
    assert result.max() <= PEAK[dtype]


@every_colour_filter
@every_type
@pytest.mark.parametrize(("top", "left", "shifted"), [(0, 1, "GRBG"), (1, 0, "GBRG"), (1, 1, "BGGR")])
def test_a_mosaic_without_its_first_row_or_column_gives_the_same_colours(algorithm, dtype, top, left, shifted):
    mosaic = sampled((scene((120, 132)) * PEAK[dtype]).astype(dtype), "RGGB")
    whole = demosaic(mosaic, "RGGB", algorithm, linear=False)
    part = demosaic(mosaic[top:, left:], shifted, algorithm, linear=False)
    inside = slice(48, -48)  # farther from the border than any filter reaches
    np.testing.assert_array_equal(part[inside, inside], whole[top:, left:][inside, inside])


@every_colour_filter
@every_type
def test_threads_change_no_bit(algorithm, dtype):
    mosaic = sampled((scene((300, 71)) * PEAK[dtype]).astype(dtype), "GBRG")
    for linear in (False, True):
        alone = demosaic(mosaic, "GBRG", algorithm, linear=linear)
        together = demosaic(mosaic, "GBRG", algorithm, linear=linear, each=by_threads)
        np.testing.assert_array_equal(alone, together)


@every_colour_filter
@every_pattern
def test_nothing_is_above_white_however_hard_the_edges(algorithm, pattern):
    for (dtype, peak), linear in product(PEAK.items(), [False, True]):
        mosaic = (np.random.default_rng(7).integers(0, 2, (24, 26)) * peak).astype(dtype)
        result = demosaic(mosaic, pattern, algorithm, white=0.75 * peak, linear=linear)
        assert result.max() <= 0.75 * peak, (dtype, linear)
        assert sampled(result, pattern)[mosaic > 0].min() == result.max(), (dtype, linear)


@pytest.mark.parametrize("algorithm", ["auto", "ri", "malvar", "bilinear", "vng"])
@pytest.mark.parametrize("linear", [False, True])
def test_integers_are_the_numbers_of_floating_point_rounded_and_not_wrapped_around(algorithm, linear):
    mosaic = np.random.default_rng(8).integers(0, 2, (24, 26)).astype(np.uint16) * np.uint16(65535)
    whole = demosaic(mosaic, "GRBG", algorithm, linear=linear)
    exact = demosaic(mosaic.astype(np.float32), "GRBG", algorithm, white=65535, linear=linear)
    # A half may be rounded up or down; float32 holds these numbers to 0.004.
    np.testing.assert_allclose(whole, np.clip(exact, 0, 65535), rtol=0, atol=0.51)


@pytest.mark.parametrize("algorithm", ["ri", "malvar"])
def test_eight_and_sixteen_bits_agree(algorithm):
    mosaic = sampled((scene((40, 50)) * 255).astype(np.uint8), "RGGB")
    fine = demosaic(mosaic.astype(np.uint16) * np.uint16(257), "RGGB", algorithm, linear=False)
    coarse = demosaic(mosaic, "RGGB", algorithm, linear=False)
    np.testing.assert_allclose(coarse, fine / 257, rtol=0, atol=0.51)  # both rounded


@pytest.mark.parametrize("algorithm", ["auto", "ri", "malvar", "bilinear", "vng"])
def test_light_below_black_stays_below_zero(algorithm):
    image = np.broadcast_to(np.float32([-0.01, -0.002, -0.03]), (9, 10, 3))
    result = demosaic(sampled(image, "BGGR"), "BGGR", algorithm)
    np.testing.assert_allclose(result, image, rtol=0, atol=1e-7)  # ten units in the last place of 0.03


def test_noise_around_black_keeps_its_mean():
    dark = np.random.default_rng(11).normal(0, 0.004, (200, 220)).astype(np.float32)
    result = demosaic(dark, "RGGB", "ri")
    # Standard error of the mean of 44 000 samples: 2e-5; a filter that lost the half below zero would give 1.6e-3.
    np.testing.assert_allclose(result.mean((0, 1)), 0, atol=2e-4)


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


def means_of_neighbours(mosaic, pattern, colours):
    height, width = mosaic.shape
    return [
        [[mean_of_neighbours(mosaic, pattern, row, column, c) for c in colours] for column in range(width)]
        for row in range(height)
    ]


@every_pattern
@pytest.mark.parametrize("shape", SIZES)
def test_bilinear_colours_are_the_means_of_their_nearest_samples(pattern, shape):
    for dtype in PEAK:
        mosaic = random_mosaic(shape, dtype)
        # integers round to the nearest; float32 sums of four carry a few units in the last place
        tolerance = 0.5 if dtype != np.float32 else 1e-6
        result = demosaic(mosaic, pattern, "bilinear")
        np.testing.assert_allclose(result, means_of_neighbours(mosaic, pattern, "BGR"), rtol=0, atol=tolerance)


def test_a_linear_ramp_is_exact_inside_by_linear_filters():
    ramp = np.add.outer(np.arange(12), np.arange(9))[..., None] + np.zeros(3)
    for algorithm in ("bilinear", "malvar"):
        result = demosaic(sampled(ramp.astype(np.float32), "RGGB"), "RGGB", algorithm, white=20)
        # float32 sums of numbers up to 20
        np.testing.assert_allclose(result[2:-2, 2:-2], ramp[2:-2, 2:-2], rtol=0, atol=1e-5)


@every_pattern
@every_type
def test_green_is_its_samples_and_the_means_of_four_between_them(pattern, dtype):
    mosaic = random_mosaic((7, 8), dtype)
    result = demosaic(mosaic, pattern, "green")
    assert (result.shape, result.dtype) == (mosaic.shape, dtype)
    tolerance = 0.5 if dtype != np.float32 else 1e-6
    expected = np.squeeze(means_of_neighbours(mosaic, pattern, "G"), -1)
    np.testing.assert_allclose(result, expected, rtol=0, atol=tolerance)


@every_pattern
@every_type
@pytest.mark.parametrize("shape", [(2, 2), (6, 8), (7, 9)])
def test_half_makes_a_pixel_of_every_whole_cell(pattern, dtype, shape):
    mosaic = random_mosaic(shape, dtype)
    height, width = shape[0] // 2, shape[1] // 2
    result = demosaic(mosaic, pattern, "half")
    assert (result.shape, result.dtype) == ((height, width, 3), dtype)
    for channel, colour in enumerate("BGR"):
        samples = [mosaic[site][:height, :width].astype(float) for site in sites(pattern, colour)]
        tolerance = 0.5 if dtype != np.float32 else 1e-7  # rounding
        np.testing.assert_allclose(result[..., channel], np.mean(samples, axis=0), rtol=0, atol=tolerance)


@pytest.mark.parametrize("algorithm", ["none", "gray"])
def test_the_mosaic_itself_can_be_had(algorithm):
    mosaic = random_mosaic((5, 6), np.uint16)
    np.testing.assert_array_equal(demosaic(mosaic, "BGGR", algorithm), mosaic)


@pytest.mark.parametrize("algorithm", ["auto", "half", "libraw:AHD"])
def test_a_frame_without_filter_comes_back_as_it_is(algorithm):
    mosaic = random_mosaic((5, 6), np.uint16)
    np.testing.assert_array_equal(demosaic(mosaic, MONO, algorithm), mosaic)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_x_trans_is_left_to_libraw(dtype):
    mosaic = random_mosaic((36, 42), dtype)
    result = demosaic(mosaic, X_TRANS, "auto")
    assert (result.shape, result.dtype) == ((36, 42, 3), dtype)
    # LibRaw brings samples back in 16 bits
    np.testing.assert_allclose(sampled(result, X_TRANS), mosaic, rtol=0, atol=0 if dtype == np.uint16 else 0.6 / 65535)
    np.testing.assert_array_equal(demosaic(mosaic, X_TRANS, "none"), mosaic)


@pytest.mark.parametrize("algorithm", ["ri", "malvar", "bilinear", "ea", "vng", "half", "green", "gray"])
def test_x_trans_is_refused_by_the_filters_for_bayer_sensors(algorithm):
    with pytest.raises(InvalidInput, match=f"{algorithm} is for Bayer sensors, this is X-Trans; use auto"):
        demosaic(random_mosaic((12, 12), np.uint16), X_TRANS, algorithm)


def test_an_algorithm_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(InvalidInput, match=", ".join(ALGORITHMS)):
        demosaic(random_mosaic((4, 4), np.uint8), "RGGB", "magic")
    with pytest.raises(InvalidInput, match="'AMAZE'"):
        require_algorithm("libraw:AMAZE")


@pytest.mark.parametrize("shape", [(1, 8), (8, 1), (4, 4, 3), (0, 0)])
def test_an_array_without_a_whole_cell_is_refused(shape):
    with pytest.raises(InvalidInput, match="2 × 2"):
        demosaic(np.zeros(shape, np.uint8), "RGGB")


def test_an_unknown_pattern_is_refused():
    with pytest.raises(InvalidInput, match="'RGB'"):
        demosaic(random_mosaic((4, 4), np.uint8), "RGB")


def test_edge_aware_floating_point_is_scaled_by_its_own_white_level():
    mosaic = np.full((8, 10), 1000, np.float32)
    colour = demosaic(mosaic, "RGGB", "ea", white=4095.0)
    np.testing.assert_allclose(colour, 1000, atol=0.04)  # half a step of 16 bits


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 300), (np.uint16, 0), (np.float32, np.nan), (np.uint8, -1)])
def test_a_white_level_that_the_type_cannot_hold_is_refused(dtype, white):
    with pytest.raises(InvalidInput, match="white level"):
        demosaic(np.zeros((4, 4), dtype), "RGGB", "bilinear", white=white)


@pytest.mark.parametrize("dtype", [np.int32, np.float64, bool])
def test_a_type_that_no_mosaic_has_is_refused(dtype):
    with pytest.raises(InvalidInput, match="uint8, uint16 or float32"):
        demosaic(np.zeros((4, 4), dtype), "RGGB")


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 4095), (np.float32, 1.0)])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_a_filter_of_libraw_takes_every_type_and_leaves_the_samples_alone(pattern, dtype, white):
    mosaic = (np.random.default_rng(6).uniform(0, white, (41, 50))).astype(dtype)
    colour = demosaic(mosaic, pattern, "libraw:LINEAR", white=white)
    assert (colour.shape, colour.dtype) == ((41, 50, 3), dtype)
    for channel, letter in enumerate("BGR"):
        for site in sites(pattern, letter):
            # half a step of the 16 bits that LibRaw works on; integers of fewer come back exactly
            tolerance = white / 65535 if dtype == np.float32 else 0
            np.testing.assert_allclose(colour[..., channel][site], mosaic[site], rtol=0, atol=tolerance)
