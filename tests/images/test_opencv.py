"""Places of the edge to OpenCV against other programs."""

import numpy as np
import pytest
from scipy.ndimage import binary_fill_holes, label
from scipy.spatial import KDTree

from camcal.opencv import largest_region, nearest_points


@pytest.mark.parametrize("count", [1, 2, 40, 900])
def test_nearest_points_are_those_of_another_tree(count):
    points = np.random.default_rng(count).uniform(0, 5000, (count, 2))
    most = min(9, count)
    distances, which = nearest_points(points, most)
    expected = KDTree(points.astype(np.float32)).query(points.astype(np.float32), k=[*range(1, most + 1)])
    np.testing.assert_array_equal(which, expected[1])
    np.testing.assert_allclose(distances, expected[0], atol=2e-3)  # of single precision


@pytest.mark.parametrize("share", [0.0, 0.35, 0.6, 0.8, 1.0])
def test_the_largest_region_has_its_holes_filled(share):
    mask = np.random.default_rng(3).uniform(size=(60, 90)) < share
    regions, count = label(mask)
    wanted = regions == 1 + np.argmax(np.bincount(regions.ravel(), minlength=2)[1:]) if count else mask
    np.testing.assert_array_equal(largest_region(mask), binary_fill_holes(wanted))
