"""Kannala–Brandt: the formula against OpenCV below 90°, by hand beyond, the axis, the fold and the inverse."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import model_named

MODEL = model_named("kannala_brandt4")
PARAMETERS = np.array([500.0, 505.0, 319.5, 241.25, 0.0035, 0.0007, -0.002, 0.0002])


def rays(theta, azimuth):
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)


def round_trip_error(parameters, points):
    found = MODEL.unproject(parameters, MODEL.project(parameters, points).pixels).directions
    return np.linalg.norm(np.cross(found, points), axis=1).max()


def test_projection_agrees_with_opencv_in_front_of_the_camera():
    rng = np.random.default_rng(4)
    points = rays(rng.uniform(0, np.radians(89), 1000), rng.uniform(0, 2 * np.pi, 1000)) * 2.0
    fx, fy, cx, cy, *coefficients = PARAMETERS
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros((3, 1)), np.zeros((3, 1)), matrix, np.array(coefficients)
    )
    np.testing.assert_allclose(MODEL.project(PARAMETERS, points).pixels, expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("degrees", [90, 95, 120, 179])
def test_projection_goes_on_beyond_the_right_angle(degrees):
    theta = np.radians(degrees)
    fx, fy, cx, cy, k1, k2, k3, k4 = PARAMETERS
    radius = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9
    expected = [[cx + fx * radius * 0.6, cy + fy * radius * 0.8]]
    point = rays(np.array([theta]), np.arctan2([0.8], [0.6]))
    np.testing.assert_allclose(MODEL.project(PARAMETERS, point).pixels, expected, atol=1e-9)


@pytest.mark.parametrize("exponent", range(1, 13))
def test_projection_and_slope_stay_accurate_towards_the_axis(exponent):
    theta = 10.0**-exponent
    result = MODEL.project_with_jacobians(PARAMETERS, 3.0 * rays(np.array([theta]), np.array([0.0])))
    k1, k2, k3, k4 = PARAMETERS[4:]
    radius = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9
    slope = 1 + 3 * k1 * theta**2 + 5 * k2 * theta**4 + 7 * k3 * theta**6 + 9 * k4 * theta**8
    assert result.pixels[0, 0] - 319.5 == pytest.approx(500 * radius, abs=2e-13)  # rounding of 319.5
    # At distance 3: along the azimuth by cos θ of the slope, across it by θ_d / sin θ, in depth by -sin θ.
    expected = np.array([[500 * slope * np.cos(theta), 0, -500 * slope * np.sin(theta)],
                         [0, 505 * radius / np.sin(theta), 0]]) / 3.0  # fmt: skip
    np.testing.assert_allclose(result.d_point[0], expected, rtol=1e-12, atol=1e-12)


def test_the_axis_itself_is_the_principal_point_and_its_continuation_behind_is_nowhere():
    result = MODEL.project_with_jacobians(PARAMETERS, np.array([[0.0, 0, 2], [0, 0, -2], [0, 0, 0]]))
    np.testing.assert_array_equal(result.valid, [True, False, False])
    np.testing.assert_array_equal(result.pixels[0], [319.5, 241.25])
    np.testing.assert_allclose(result.d_point[0], [[250, 0, 0], [0, 252.5, 0]], atol=1e-12)


def test_fold_ends_the_domain():
    parameters = np.array([500.0, 500, 320, 240, -0.2, 0, 0, 0])
    theta = np.sqrt(1 / 0.6)  # 1 - 3 · 0.2 θ² = 0
    domain = MODEL.domain(parameters)
    assert domain.max_theta == pytest.approx(theta, abs=1e-12)
    assert domain.max_radius_px == pytest.approx(500 * (theta - 0.2 * theta**3), abs=1e-9)
    np.testing.assert_array_equal(
        MODEL.project(parameters, rays(theta + np.array([-1e-6, 1e-6]), np.ones(2))).valid, [True, False]
    )


def test_domain_of_a_lens_without_fold_is_the_whole_sphere():
    domain = MODEL.domain(np.array([500.0, 400, 320, 240, 0, 0, 0, 0]))
    assert domain.max_theta == np.pi
    assert domain.max_radius_px == pytest.approx(400 * np.pi)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
def test_unprojection_is_exact_close_to_the_fold(gap):
    parameters = np.array([500.0, 505, 320, 240, 0.05, -0.2, 0.1, -0.05])
    theta = MODEL.domain(parameters).max_theta * (1 - gap)
    points = rays(np.full(50, theta), np.linspace(0, 2 * np.pi, 50))
    assert round_trip_error(parameters, points) < 1e-9  # 1e-16 of rounding over a slope of about `gap`


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 4), st.floats(0, 0.999), st.floats(0, 2 * np.pi))
def test_any_lens_is_inverted_over_its_whole_domain(coefficients, share, azimuth):
    parameters = np.array([300.0, 310, 320, 240, *coefficients])
    point = rays(np.array([share * MODEL.domain(parameters).max_theta]), np.array([azimuth]))
    assert round_trip_error(parameters, point) < 1e-9


def test_the_prior_of_each_coefficient_follows_its_power_of_theta():
    theta = 1000 / 3000  # of the image corner: half the diagonal of 1600 x 1200 over the focal length
    spread = MODEL.prior_std((1600, 1200), 3000.0)
    np.testing.assert_allclose(spread[4:], theta ** -np.array([2.0, 4.0, 6.0, 8.0]))
    wide = MODEL.prior_std((1600, 1200), 400.0)  # a corner at 143°, most likely outside the image circle
    np.testing.assert_allclose(wide[4:], (np.pi / 2) ** -np.array([2.0, 4.0, 6.0, 8.0]))
