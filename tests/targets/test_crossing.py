"""The pictures of crossing edges against the normal distribution they are made from."""

import numpy as np
import pytest
from scipy.special import erf
from scipy.stats import multivariate_normal, norm

from camcal.targets.corner_refinement import alone, crossing, crowded, edge

PLACES = np.linspace(-3, 3, 9)
FIRST, SECOND = (part.astype(np.float32) for part in np.meshgrid(PLACES, PLACES))
WORST = {0.0: 1e-6, 0.1: 1e-5, 0.3: 5e-4, 0.5: 4e-3, 0.7: 2e-2}  # the terms left out, of order ρ⁴ / 24


def quadrants(first, second, correlation):
    """E[sign(z₁ + ε₁) sign(z₂ + ε₂)] from the bivariate normal distribution."""
    both = multivariate_normal([0, 0], [[1, correlation], [correlation, 1]])
    joint = np.vectorize(lambda u, v: both.cdf([u, v]))(first, second)
    return 4 * joint - 2 * norm.cdf(first) - 2 * norm.cdf(second) + 1


def test_an_edge_is_an_error_function_to_less_than_a_gray_level_shows():
    places = np.linspace(-60, 60, 5001)
    side, density = edge(places)
    assert np.abs(side - erf(places / np.sqrt(2))).max() < 6e-7
    np.testing.assert_allclose(density, norm.pdf(places), atol=1e-7)


@pytest.mark.parametrize("correlation", WORST)
def test_the_picture_is_that_of_the_bivariate_normal_distribution(correlation):
    skew = np.full((len(FIRST), 1), correlation, np.float32)
    value = crossing(FIRST, SECOND, skew)[0]
    assert np.abs(value - quadrants(FIRST, SECOND, correlation)).max() < WORST[correlation]


@pytest.mark.parametrize("correlation", [0.0, -0.4, 0.6])
def test_derivatives_are_those_of_the_picture(correlation):
    first, second = FIRST.astype(np.float64), SECOND.astype(np.float64)
    skew, step = np.full((len(first), 1), correlation), 1e-2  # the error function has an error of 5e-7
    _, *slopes = crossing(first, second, skew)
    by_first = (crossing(first + step, second, skew)[0] - crossing(first - step, second, skew)[0]) / (2 * step)
    by_second = (crossing(first, second + step, skew)[0] - crossing(first, second - step, skew)[0]) / (2 * step)
    np.testing.assert_allclose(slopes, [by_first, by_second], atol=2e-4)


def test_the_picture_looks_the_same_after_half_a_turn():
    skew = np.full((len(FIRST), 1), 0.5, np.float32)
    np.testing.assert_allclose(crossing(FIRST, SECOND, skew)[0], crossing(-FIRST, -SECOND, skew)[0], atol=1e-6)


def family(middle, before, after):
    return np.stack([middle + before, middle, middle - after])


def test_far_neighbours_change_nothing():
    none, skew = np.zeros((len(FIRST), 2, 2), bool), np.full((len(FIRST), 1), 0.4, np.float32)
    lone = alone(FIRST, SECOND, skew)
    full = crowded(family(FIRST, 20, 20), family(SECOND, 20, 20), skew, none, np.ones((len(FIRST), 1)))
    np.testing.assert_allclose(full[0], lone[0], atol=1e-5)
    np.testing.assert_allclose(full[1:], lone[1:], atol=1e-5)


@pytest.mark.parametrize("bright", [1, -1])
@pytest.mark.parametrize("border", [None, (0, 0), (0, 1), (1, 0), (1, 1)])
def test_near_neighbours_and_borders_look_as_a_drawing_does_under_noise(border, bright):
    rng, step = np.random.default_rng(3), 2.5
    shake = rng.normal(size=(2, 200_000))
    flags = np.zeros((1, 2, 2), bool)
    if border is not None:
        flags[0, border[0], border[1]] = True
    for u, v in rng.uniform(-1.25, 1.25, (6, 2)):
        places = [u + shake[0], v + shake[1]]
        rows = [np.sign(p) - np.sign(p - step) - np.sign(p + step) for p in places]
        drawn = rows[0] * rows[1]
        if border is not None:
            place = places[border[0]]
            beyond = place > step if border[1] else place < -step
            drawn = np.where(beyond, bright, drawn)  # white margin beyond the squares
        first, second = (np.full((1, 1), place, np.float32) for place in (u, v))
        seen = crowded(
            family(first, step, step), family(second, step, step), np.zeros((1, 1)), flags, np.array([[bright]])
        )
        assert abs(seen[0][0, 0] - drawn.mean()) < 5 / np.sqrt(200_000)  # 5 standard errors at most


def test_derivatives_by_place_and_blur_are_those_of_the_crowded_picture():
    border = np.zeros((1, 2, 2), bool)
    border[0, 0, 1] = border[0, 1, 0] = True
    bright, skew, step = np.ones((1, 1)), np.full((1, 1), 0.3), 1e-2  # single precision

    def seen(first=0.0, second=0.0, blur_1=1.0, blur_2=1.0):
        u, v = np.full((1, 1), 0.4), np.full((1, 1), -0.7)
        lines_1, lines_2 = family(u, 2.4, 2.6), family(v, 2.5, 2.2)
        lines_1[1] += first
        lines_2[1] += second
        return crowded(lines_1 / blur_1, lines_2 / blur_2, skew, border, bright)

    _, by_distances, by_blurs = seen()
    for name, by_distance in zip(("first", "second"), by_distances, strict=True):
        slope = (seen(**{name: step})[0] - seen(**{name: -step})[0]) / (2 * step)
        np.testing.assert_allclose(by_distance, slope, atol=2e-4)
    for name, by_blur in zip(("blur_1", "blur_2"), by_blurs, strict=True):
        slope = (seen(**{name: 1 + step})[0] - seen(**{name: 1 - step})[0]) / (2 * step)
        np.testing.assert_allclose(by_blur, -slope, atol=1e-3)  # third derivatives are larger
