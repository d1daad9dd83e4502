"""What lies in the convex hull of corners, against Qhull."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from camcal.cameras.directions import in_hull


@pytest.mark.parametrize("seed", range(5))
def test_pixels_in_the_hull_of_corners_are_those_within_its_sides(seed):
    rng = np.random.default_rng(seed)
    corners = rng.normal([900, 500], [300, 200], (200, 2))
    pixels = rng.uniform(0, 1900, (2000, 2))
    sides = ConvexHull(corners).equations
    outside = (pixels @ sides[:, :2].T + sides[:, 2]).max(axis=1)  # px
    clear = np.abs(outside) > 1e-2
    np.testing.assert_array_equal(in_hull(pixels, corners)[clear], (outside < 0)[clear])
    assert in_hull(corners, corners).all()


@pytest.mark.parametrize(
    "corners", [np.zeros((0, 2)), np.ones((2, 2)), np.outer(np.arange(9.0), [31.7, 3.3]), np.ones((5, 2))]
)
def test_corners_on_one_line_enclose_nothing(corners):
    assert not in_hull(np.array([[1.0, 1.0], [63.4, 6.6]]), corners).any()
