"""LibRaw's filters: what they may not change. How good they are is measured elsewhere."""

import numpy as np
import pytest

from camcal.errors import InvalidInput
from camcal.raw import PATTERNS
from camcal.raw.demosaic import demosaic, demosaic_with_libraw, libraw_filters, require_libraw_filter
from camcal.raw.mosaic import sites

X_TRANS = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG"
COLOUR = (20000, 40000, 10000)  # blue, green, red
ALWAYS = ("LINEAR", "VNG", "PPG", "AHD", "DCB", "DHT", "AAHD")  # those LibRaw has without the packs under the GPL


def noise(shape, seed=0):
    return np.random.default_rng(seed).integers(0, 65536, shape).astype(np.uint16)


def mosaic_of_one_colour(shape, pattern):
    values = np.empty(shape, np.uint16)
    for level, colour in zip(COLOUR, "BGR", strict=True):
        for site in sites(pattern, colour):
            values[site] = level
    return values


def assert_samples_unchanged(image, values, pattern):
    assert image.shape == (*values.shape, 3)
    assert image.dtype == np.uint16
    for channel, colour in enumerate("BGR"):
        for site in sites(pattern, colour):
            np.testing.assert_array_equal(image[..., channel][site], values[site])


def test_the_names_are_those_that_work_and_no_others():
    assert set(ALWAYS) <= set(libraw_filters())
    assert require_libraw_filter("ahd") == "AHD"


def test_a_filter_that_libraw_would_replace_in_silence_is_refused():
    missing = next(name for name in ("AMAZE", "LMMSE", "AFD") if name not in libraw_filters())
    with pytest.raises(InvalidInput, match=rf"'{missing}' and would use AHD instead.*LINEAR, VNG"):
        demosaic_with_libraw(noise((40, 40)), "RGGB", missing)


@pytest.mark.parametrize("name", ALWAYS)
@pytest.mark.parametrize("shape", [(40, 64), (61, 75)])
def test_every_filter_leaves_the_samples_as_they_are(name, shape):
    values = noise(shape)
    assert_samples_unchanged(demosaic_with_libraw(values, "RGGB", name), values, "RGGB")


@pytest.mark.parametrize("pattern", PATTERNS)
def test_every_phase_has_its_colours_in_their_place(pattern):
    image = demosaic_with_libraw(mosaic_of_one_colour((41, 33), pattern), pattern, "PPG")
    np.testing.assert_array_equal(image, np.broadcast_to(COLOUR, image.shape))


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (7, 100), (21, 22), (23, 23)])
def test_images_smaller_than_libraw_takes_keep_their_size(shape):
    values = noise(shape)
    assert_samples_unchanged(demosaic_with_libraw(values, "GRBG", "AHD"), values, "GRBG")


def test_linear_is_the_mean_of_the_nearest_samples_without_any_scaling():
    values = noise((61, 75))
    image = demosaic_with_libraw(values, "GBRG", "LINEAR")
    # LibRaw weighs with 8 fractional bits and rounds down, and does the border in its own way
    difference = np.abs(image.astype(int) - demosaic(values, "GBRG", "bilinear"))[2:-2, 2:-2]
    assert difference.max() <= 1


@pytest.mark.parametrize("shape", [(66, 72), (7, 30)])
def test_x_trans_is_demosaiced_by_the_filter_made_for_it(shape):
    values = mosaic_of_one_colour(shape, X_TRANS)
    image = demosaic_with_libraw(values, X_TRANS, "AHD")
    assert_samples_unchanged(image, values, X_TRANS)
    np.testing.assert_array_equal(image[1:-1, 1:-1], np.broadcast_to(COLOUR, image[1:-1, 1:-1].shape))


@pytest.mark.parametrize(("pattern", "name", "words"), [(X_TRANS, "VNG", "use AHD"), ("MONO", "AHD", "no demosaicing")])
def test_what_libraw_has_no_filter_for_is_refused(pattern, name, words):
    with pytest.raises(InvalidInput, match=words):
        demosaic_with_libraw(noise((40, 40)), pattern, name)
