"""Homographies from points, and where they take points."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camcal.targets.board_map import apply_homography, homography_of

SQUARE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
SLOPES = st.floats(-0.3, 0.3)


@given(lean=SLOPES, tip=SLOPES, turn=st.floats(-3, 3), across=st.floats(-1e3, 1e3))
def test_four_points_say_which_homography_it_is(lean, tip, turn, across):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    truth = np.block([[200 * rotation, np.array([[across], [50.0]])], [np.array([[lean, tip, 1.0]])]])
    found = homography_of(SQUARE, apply_homography(truth, SQUARE))
    # the normal equations of the normalised points keep half of the digits
    np.testing.assert_allclose(found, truth, rtol=1e-6, atol=1e-4)


def test_more_points_outvote_their_noise():
    truth = np.array([[300.0, 20, 40], [-10, 280, 60], [0.2, -0.1, 1]])
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 1, (400, 2))
    seen = apply_homography(truth, points) + rng.normal(0, 0.1, (400, 2))
    off = apply_homography(homography_of(points, seen), SQUARE) - apply_homography(truth, SQUARE)
    assert np.abs(off).max() < 0.08  # 0.1 px / √400 in the middle, some times that at the corners


def test_the_inverse_takes_points_back():
    homography = np.array([[3.0, 0.2, 4], [-0.1, 2.8, 6], [0.02, -0.01, 1]])
    back = apply_homography(np.linalg.inv(homography), apply_homography(homography, SQUARE))
    np.testing.assert_allclose(back, SQUARE, atol=1e-12)  # rounding


def test_scale_does_not_matter():
    homography = np.array([[3.0, 0.2, 4], [-0.1, 2.8, 6], [0.02, -0.01, 1]])
    np.testing.assert_allclose(
        apply_homography(-7 * homography, SQUARE), apply_homography(homography, SQUARE), atol=1e-12
    )  # rounding
