"""Numerical derivatives against functions whose derivatives are known."""

import numpy as np
import pytest

from camcal.geometry import rotation as so3
from camcal.solve.differentiate import central_jacobian, check_jacobian, complex_jacobian

AT = np.array([0.7, -2e3, 3e-5])


def curve(x):
    return np.array([np.exp(x[0]) * np.sin(x[2] * 1e4), x[0] * x[1] ** 2 + x[2], np.sqrt(1 + x[1] ** 2)])


def slopes(x):
    return np.array(
        [
            [np.exp(x[0]) * np.sin(x[2] * 1e4), 0, 1e4 * np.exp(x[0]) * np.cos(x[2] * 1e4)],
            [x[1] ** 2, 2 * x[0] * x[1], 1],
            [0, x[1] / np.sqrt(1 + x[1] ** 2), 0],
        ]
    )


def test_complex_steps_are_exact_to_rounding():
    np.testing.assert_allclose(complex_jacobian(curve, AT), slopes(AT), rtol=1e-15, atol=1e-30)


def test_central_differences_are_good_to_eleven_digits_of_a_columns_size():
    numeric, exact = central_jacobian(curve, AT), slopes(AT)
    # rounding: values near 3e6 known to 3e-10, over steps of 1e-3 of the variables, are 1e-10 of their slopes
    assert np.all(np.abs(numeric - exact) <= 1e-10 * np.abs(curve(AT)).max() / np.abs(AT))


def test_a_function_on_a_manifold_is_differentiated_by_its_step():
    rotation, point = so3.exp(np.array([0.3, -0.2, 0.5])), np.array([1.0, 2.0, -1.0])
    numeric = central_jacobian(lambda d: so3.exp(d) @ rotation @ point, np.zeros(3), 1e-3)
    # the fourth order leaves 1e-15 at steps of 1e-3, rounding 1e-13
    np.testing.assert_allclose(numeric, -so3.hat(rotation @ point), atol=2e-12)


def test_the_check_says_how_far_off_a_jacobian_is_and_where():
    wrong = slopes(AT)
    wrong[1, 1] *= 1.01
    for analytic in (True, False):
        check = check_jacobian(curve, wrong, AT, analytic=analytic)
        assert (check.row, check.column) == ((1,), 1)
        assert check.error == pytest.approx(0.01, rel=1e-6)
        assert check.method == ("complex" if analytic else "central")
    assert check_jacobian(curve, slopes(AT), AT, analytic=True).error < 1e-15


def test_a_jacobian_that_is_not_a_number_is_as_wrong_as_can_be():
    wrong = slopes(AT)
    wrong[0, 2] = np.nan
    assert check_jacobian(curve, wrong, AT, analytic=True).error == np.inf
