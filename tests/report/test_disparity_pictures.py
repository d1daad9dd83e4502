"""Pictures of disparity maps: what stands at a pixel has the colour of its number, and the legend is below."""

import numpy as np
import pytest

from camcal.report.stereo_pictures import ERROR_EDGES, disparity_picture, error_picture, robust_range
from camcal.stereo.disparity import StereoGeometry

GEOMETRY = StereoGeometry(1000, 1000, 5, 5, 0.2)
HEIGHT, WIDTH = 40, 500
RAMP = np.broadcast_to(np.linspace(0, 100, WIDTH, dtype=np.float32), (HEIGHT, WIDTH))


def test_the_picture_stands_above_a_legend_of_its_own_width():
    picture = disparity_picture(RAMP)
    assert picture.dtype == np.uint8
    assert picture.shape[1:] == (WIDTH, 3)
    legend = picture[HEIGHT:]
    assert (legend == 255).all(axis=2).mean() > 0.3  # paper
    assert (legend == 0).all(axis=2).any()  # ink


def test_the_first_colour_is_blue_and_the_last_red():
    coloured = disparity_picture(RAMP)[:HEIGHT].astype(int)
    blue, _, red = coloured[0, 5]
    assert blue > red + 50
    blue, _, red = coloured[0, -5]
    assert red > blue + 50


def test_black_means_no_match_and_nothing_else():
    values = RAMP.copy()
    values[:, 100:120] = np.nan
    values[0, 120] = np.inf  # beyond the last colour
    black = (disparity_picture(values)[:HEIGHT] == 0).all(axis=2)
    np.testing.assert_array_equal(black, np.isnan(values))


def test_the_same_limits_give_the_same_colours_whatever_else_is_in_the_frame():
    other = RAMP + 0
    other[:, 250:] = 1000
    limits = robust_range(RAMP)
    first, second = (disparity_picture(values, limits)[:HEIGHT, :250] for values in (RAMP, other))
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first, disparity_picture(other)[:HEIGHT, :250])


def test_a_few_outliers_do_not_stretch_the_range():
    values = np.full((100, 100), 20.0, np.float32)
    values[:50] = 10
    values[0, 0] = 5000
    assert robust_range(values) == (10, 20)


@pytest.mark.parametrize(
    "values", [np.full((3, 4), np.nan), np.full((1, 1), 7.0), np.zeros((2, 2)), np.full((2, 1500), -3.0)]
)
def test_odd_maps_have_a_picture(values):
    low, high = robust_range(values)
    assert low < high
    picture = disparity_picture(values.astype(np.float32), geometry=GEOMETRY)
    assert picture.shape[0] > values.shape[0]
    assert picture.shape[1] >= values.shape[1]


@pytest.mark.parametrize("width", [421, 741, 1009, 1241])
def test_every_width_fits_its_legend(width):
    assert disparity_picture(np.ones((2, width), np.float32)).shape[1] == width


def test_metres_are_added_where_the_geometry_is_known():
    without, told = disparity_picture(RAMP)[HEIGHT:], disparity_picture(RAMP, geometry=GEOMETRY)[HEIGHT:]
    lowest = slice(len(told) * 2 // 3, None)
    assert (without[lowest] == 255).all()
    assert (told[lowest] < 128).any()


def test_errors_have_the_colour_of_their_class():
    error = np.array([[0.0, 0.25, 0.3, 2.0, 2.1, 100.0]], np.float32)
    coloured = error_picture(error, np.ones_like(error, bool))[0, : error.size]
    same = [(coloured[a] == coloured[b]).all() for a, b in ((0, 1), (1, 2), (3, 4), (4, 5))]
    assert same == [True, False, False, False]  # just the threshold is not above it
    blue, red = coloured[:, 0].astype(int), coloured[:, 2].astype(int)
    np.testing.assert_array_equal(blue > red, error[0] <= 2)


def test_each_class_of_errors_has_a_colour_of_its_own():
    error = np.array([[0.1, *(edge * 1.5 for edge in ERROR_EDGES), np.nan, 1]], np.float32)
    known = np.ones_like(error, bool)
    known[0, -1] = False
    coloured = error_picture(error, known)[0, : error.size]
    assert len({tuple(pixel) for pixel in coloured.tolist()}) == error.size
    assert coloured[-1].tolist() == [0, 0, 0]


def test_what_is_occluded_is_darker():
    error = np.ones((2, 500), np.float32)
    visible = np.arange(500) < 250
    picture = error_picture(error, np.ones_like(error, bool), np.broadcast_to(visible, error.shape))
    assert picture[0, 0].sum() > 1.5 * picture[0, -1].sum()
