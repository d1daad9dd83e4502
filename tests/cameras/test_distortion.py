"""Roots and the tilt's homography, the two pieces of the distortion that are worth a test of their own."""

import numpy as np
import pytest

from camcal.cameras.distortion import first_root
from camcal.cameras.tilt import Tilt
from camcal.solve.differentiate import central_jacobian


@pytest.mark.parametrize(
    ("coefficients", "root"),
    [
        ([1.0], np.inf),
        ([1.0, 1.0], np.inf),
        ([1.0, -0.5], 2.0),
        ([1.0, -1.5, 0.5], 1.0),
        ([1.0, -1.0, 0.25], 2.0),  # a double root
        ([1.0, 0.0, 1.0], np.inf),
        ([1.0, -0.5, 1e-300], 2.0),
        ([1.0, -0.5, 0.0, 0.0], 2.0),
        ([1.0, np.nan], 0.0),
        ([1.0, -np.inf, 1.0], 0.0),
    ],
)
def test_first_root_is_the_smallest_positive_one(coefficients, root):
    assert first_root(np.array(coefficients)) == pytest.approx(root, rel=1e-7)  # a double root has half the digits


def test_an_untilted_sensor_changes_nothing():
    np.testing.assert_array_equal(Tilt(0.0, 0.0).homography(), np.eye(3))


def test_tilt_derivatives_are_the_slopes_of_the_homography():
    analytic = np.stack(Tilt(0.2, -0.3).homography_derivatives(), axis=-1)
    numeric = central_jacobian(lambda angles: Tilt(*angles).homography(), np.array([0.2, -0.3]))
    np.testing.assert_allclose(analytic, numeric, atol=1e-11)  # of numbers near 1, extrapolated


def test_tilt_is_undone():
    x, y = np.array([0.1, -0.5, 0.3]), np.array([0.2, 0.4, -0.6])
    tilt = Tilt(0.2, -0.3)
    first, second, scale = (row.ravel() for row in np.vsplit(tilt.homography() @ np.stack([x, y, np.ones(3)]), 3))
    np.testing.assert_allclose(tilt.undo(first / scale, second / scale), [x, y], atol=1e-15)
