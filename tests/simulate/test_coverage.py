"""Images from outlines: areas, point spreads and what lies outside the image.

The point spread is checked against its definition by numerical integration, not against another renderer;
test_render.py does that.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from camcal.simulate.render import draw, piece_length

MOVE = np.array([8.0, 5.0])
PLACE = st.floats(-10.0, 30.0)


def polygon(corners, blur):
    """Return a closed path around corners (N, 2) in short steps."""
    closed = np.vstack([corners, corners[:1]])
    sides = [
        a + (b - a) * np.linspace(0, 1, 2 + int(np.hypot(*(b - a)) / piece_length(blur)))[:-1, None]
        for a, b in pairwise(closed)
    ]
    return np.vstack([*sides, corners[:1]])


def region(size, corners, blur=0.0):
    path = polygon(np.asarray(corners, dtype=float), blur)
    # An outline has its inside at larger u where it runs along -v.
    return draw(size, path, np.ones(len(path) - 1), blur)


def overlap(low, high, count):
    """Return the length (count,) of [low, high] within every pixel of a row."""
    centres = np.arange(count)
    return np.clip(np.minimum(high, centres + 0.5) - np.maximum(low, centres - 0.5), 0, 1)


def test_a_rectangle_covers_every_pixel_by_its_area():
    image = region((12, 9), [(2.3, 1.1), (8.8, 1.1), (8.8, 6.25), (2.3, 6.25)])
    expected = np.outer(overlap(1.1, 6.25, 9), overlap(2.3, 8.8, 12))
    assert np.allclose(image, expected, atol=2e-4)  # the table of the spread places edges to 6e-5 px, twice


@pytest.mark.parametrize("blur", [0.0, 0.3, 0.7, 2.0])
def test_an_edge_is_the_point_spread_summed_up(blur):
    image = region((21, 5), [(10.37, -50), (90, -50), (90, 50), (10.37, 50)], blur)

    def share(pixel):  # of the pixel's square beyond the edge, under a Gaussian
        if blur == 0:
            return np.clip(pixel + 0.5 - 10.37, 0, 1)
        return quad(lambda u: norm.cdf((u - 10.37) / blur), pixel - 0.5, pixel + 0.5)[0]

    expected = [share(pixel) for pixel in range(21)]
    assert np.allclose(image, expected, atol=2e-4)  # the tails beyond 4 standard deviations hold 6e-5


@given(corners=st.lists(st.tuples(PLACE, PLACE), min_size=3, max_size=3), blur=st.sampled_from([0.0, 0.5, 1.0]))
def test_the_whole_image_holds_the_area_of_a_triangle(corners, blur):
    corners = np.array(corners) + 20
    (ax, ay), (bx, by), (cx, cy) = corners
    area = ((bx - ax) * (cy - ay) - (cx - ax) * (by - ay)) / 2
    # Steps count as if they were at their middle: exact for the area of straight outlines, up to the table's fineness.
    assert region((70, 70), corners, blur).sum() == pytest.approx(area, abs=2e-4 * (1 + np.ptp(corners)))


@given(corners=st.lists(st.tuples(PLACE, PLACE), min_size=3, max_size=5))
def test_what_lies_outside_the_image_does_not_matter(corners):
    corners = np.array(corners)
    path = polygon(corners, 0.7)
    jumps = np.ones(len(path) - 1)
    whole = draw((120, 110), path + np.array([50, 45]), jumps, 0.7)
    assert np.allclose(draw((20, 16), path, jumps, 0.7), whole[45:61, 50:70], atol=1e-9)


def test_a_lifted_pen_draws_nothing():
    square = np.array([(2.0, 2.0), (6.0, 2.0), (6.0, 6.0), (2.0, 6.0)])
    one, other = polygon(square, 0.5), polygon(square + MOVE, 0.5)
    path = np.vstack([one, other])
    jumps = np.ones(len(path) - 1)
    jumps[len(one) - 1] = 0
    together = draw((20, 16), path, jumps, 0.5)
    assert np.allclose(together, region((20, 16), square, 0.5) + region((20, 16), square + MOVE, 0.5), atol=1e-12)
