"""The decentred fisheye: its formula by OpenCV and by hand, what it has in common with kannala_brandt4, its fold and
its inverse. That lenses of this kind exist is not shown here.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import folds_inside
from camcal.solve.differentiate import central_jacobian

FOUR, MODEL = model_named("kannala_brandt4"), model_named("kannala_brandt5t")
CORE = [500.0, 505.0, 319.5, 241.25]
PARAMETERS = np.array([*CORE, 0.0035, 0.0007, -0.002, 0.0002, -0.00001, 0.004, -0.003])


def rays(theta, azimuth):
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)


def decentred(p1, p2, **radial):
    return np.array([500.0, 500, 320, 240, *(radial.get(name, 0.0) for name in ("k1", "k2", "k3", "k4", "k5")), p1, p2])


def round_trip_error(parameters, points):
    found = MODEL.unproject(parameters, MODEL.project(parameters, points).pixels).directions
    return np.linalg.norm(np.cross(found, points), axis=1).max()


def by_hand(parameters, theta, azimuth):
    fx, fy, cx, cy, k1, k2, k3, k4, k5, p1, p2 = parameters
    radius = theta + k1 * theta**3 + k2 * theta**5 + k3 * theta**7 + k4 * theta**9 + k5 * theta**11
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    x_d = x + 2 * p1 * x * y + p2 * (radius**2 + 2 * x**2)
    y_d = y + p1 * (radius**2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([fx * x_d + cx, fy * y_d + cy], axis=-1)


def test_parameters_have_their_order():
    assert " ".join(MODEL.parameter_names) == "fx fy cx cy k1 k2 k3 k4 k5 p1 p2"


def test_it_is_opencvs_fisheye_followed_by_opencvs_tangential_terms():
    rng = np.random.default_rng(4)
    points = rays(rng.uniform(0, np.radians(89), 1000), rng.uniform(0, 2 * np.pi, 1000)) * 2.0
    parameters = PARAMETERS.copy()
    parameters[8] = 0.0  # OpenCV has no k5
    at_rest = np.zeros((3, 1)), np.zeros((3, 1))
    radial, _ = cv2.fisheye.projectPoints(points[:, None], *at_rest, np.eye(3), parameters[4:8])
    moved = np.append(radial.reshape(-1, 2), np.ones((1000, 1)), axis=1)
    matrix = np.array([[500, 0, 319.5], [0, 505, 241.25], [0, 0, 1.0]])
    expected, _ = cv2.projectPoints(moved, *at_rest, matrix, np.array([0, 0, *parameters[9:]]))
    np.testing.assert_allclose(MODEL.project(parameters, points).pixels, expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("degrees", [0, 10, 60, 90, 95, 120])
def test_projection_is_the_formula_beyond_the_right_angle_too(degrees):
    theta, azimuth = np.full(12, np.radians(degrees)), np.linspace(0, 2 * np.pi, 12)
    found = MODEL.project(PARAMETERS, 3.0 * rays(theta, azimuth))
    np.testing.assert_allclose(found.pixels, by_hand(PARAMETERS, theta, azimuth), atol=1e-9)


def test_without_terms_of_its_own_it_is_exactly_kannala_brandt4():
    rng = np.random.default_rng(7)
    points = rays(rng.uniform(0, 3, 2000), rng.uniform(0, 2 * np.pi, 2000))
    four = np.array([*CORE, -0.03, -0.001, -0.0003, 0.00001])  # folds at 139°
    five = np.append(four, [0.0, 0.0, 0.0])
    assert MODEL.domain(five) == FOUR.domain(four)
    ours, theirs = MODEL.project_with_jacobians(five, points), FOUR.project_with_jacobians(four, points)
    assert 0 < np.count_nonzero(theirs.valid) < 2000
    np.testing.assert_array_equal(ours.valid, theirs.valid)
    np.testing.assert_array_equal(ours.pixels, theirs.pixels)
    np.testing.assert_array_equal(ours.d_point, theirs.d_point)
    np.testing.assert_array_equal(ours.d_parameters[:, :, :8], theirs.d_parameters)
    pixels = rng.uniform((0, 0), (640, 480), (2000, 2))
    np.testing.assert_array_equal(MODEL.unproject(five, pixels).directions, FOUR.unproject(four, pixels).directions)


def test_jacobians_are_the_slopes_of_a_strongly_decentred_lens_beyond_the_right_angle():
    parameters = np.array([*CORE, -0.03, 0.004, -0.0005, 0.0001, -0.00001, 0.04, -0.03])
    rng = np.random.default_rng(5)
    points = 2.0 * rays(rng.uniform(0, np.radians(110), 200), rng.uniform(0, 2 * np.pi, 200))
    found = MODEL.project_with_jacobians(parameters, points)
    assert found.valid.all()
    by_parameters = central_jacobian(lambda p: MODEL.project(p, points).pixels, parameters, 1e-5)
    by_point = central_jacobian(lambda d: MODEL.project(parameters, points + d).pixels, np.zeros(3), 1e-4)
    # rounding of pixels near 2000 over steps of 1e-5 and 1e-4: 2e-8 and 2e-9
    np.testing.assert_allclose(found.d_parameters, by_parameters, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found.d_point, by_point, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("exponent", range(1, 13))
def test_a_ray_next_to_the_axis_comes_back(exponent):
    points = rays(np.full(8, 10.0**-exponent), np.arange(8.0))
    assert round_trip_error(PARAMETERS, points) < 1e-9


def test_tangential_terms_alone_fold_where_they_undo_the_angle():
    parameters = decentred(0.12, 0.16)  # of size 0.2: towards (-p2, -p1) the radius is θ - 3 · 0.2 θ²
    domain = MODEL.domain(parameters)
    assert domain.max_theta == pytest.approx(1 / 1.2, abs=1e-12)
    azimuth = np.full(3, np.arctan2(-0.12, -0.16))
    theta = domain.max_theta + np.array([-1e-6, 1e-6, 0.1])
    found = MODEL.project_with_jacobians(parameters, rays(theta, azimuth), within_domain=False)
    assert abs(np.linalg.det(found.d_point[0][:, :2])) < 1e-4 * 500**2  # the slope of the fold is 1e-6
    outward = np.linalg.norm(found.pixels - [320, 240], axis=1)
    assert outward[2] < outward[0]
    np.testing.assert_array_equal(MODEL.project(parameters, rays(theta, azimuth)).valid, [True, False, False])


def test_tangential_terms_fold_by_the_distorted_angle():
    parameters = decentred(0.15, 0.0, k1=-0.1)
    theta = MODEL.domain(parameters).max_theta
    assert theta - 0.1 * theta**3 == pytest.approx(1 / 0.9, abs=1e-12)
    assert MODEL.domain(parameters).max_radius_px == pytest.approx(500 / 0.9)


def test_a_radial_fold_nearer_than_that_of_the_tangential_terms_ends_the_domain():
    parameters = decentred(0.01, -0.01, k1=-0.2)
    assert MODEL.domain(parameters).max_theta == pytest.approx(np.sqrt(1 / 0.6), abs=1e-12)  # 1 - 3 · 0.2 θ² = 0


def test_mild_decentring_leaves_the_whole_sphere():
    assert MODEL.domain(decentred(0.003, -0.004)).max_theta == np.pi


def test_the_fold_is_found_inside_an_image():
    camera = Camera(MODEL, (641, 481), decentred(0.0, 0.5))
    fold = folds_inside(camera)
    assert fold.folds
    # to the left, where the angle 1/3 has become 1/3 - 3 · 0.5 / 9
    assert fold.radius_px == pytest.approx(500 / 6, rel=0.01)  # of 64 directions


def test_unprojection_inverts_projection_beyond_the_right_angle():
    rng = np.random.default_rng(6)
    theta = rng.uniform(0, MODEL.domain(PARAMETERS).max_theta - 1e-3, 2000)
    assert theta.max() > np.radians(95)
    assert round_trip_error(PARAMETERS, rays(theta, rng.uniform(0, 2 * np.pi, 2000))) < 1e-9


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("tangential", [0.001, 0.1])
def test_unprojection_is_exact_close_to_the_fold(gap, tangential):
    parameters = decentred(tangential, 0.5 * tangential, k1=0.05, k2=-0.2, k3=0.1, k4=-0.05)
    theta = MODEL.domain(parameters).max_theta * (1 - gap)
    points = rays(np.full(50, theta), np.linspace(0, 2 * np.pi, 50))
    assert round_trip_error(parameters, points) < 1e-9  # 1e-16 of rounding over a slope of about `gap`


@given(st.tuples(*[st.floats(-0.3, 0.3)] * 5, *[st.floats(-0.1, 0.1)] * 2), st.floats(0, 0.99), st.floats(0, 2 * np.pi))
def test_any_lens_is_inverted_over_its_domain(coefficients, share, azimuth):
    parameters = np.array([300.0, 310, 320, 240, *coefficients])
    point = rays(np.array([share * MODEL.domain(parameters).max_theta]), np.array([azimuth]))
    assert round_trip_error(parameters, point) < 1e-9


def test_priors_follow_the_powers_of_theta():
    theta = 1000 / 3000  # of the image corner: half the diagonal of 1600 x 1200 over the focal length
    powers = -np.array([2.0, 4.0, 6.0, 8.0, 10.0, 1.0, 1.0])
    np.testing.assert_allclose(MODEL.prior_std((1600, 1200), 3000.0)[4:], theta**powers)
    wide = MODEL.prior_std((1600, 1200), 400.0)  # a corner at 143°, most likely outside the image circle
    np.testing.assert_allclose(wide[4:], (np.pi / 2) ** powers)
    np.testing.assert_array_equal(wide[:8], FOUR.prior_std((1600, 1200), 400.0))


def test_its_stages_are_those_of_narrow_lenses():
    model = model_named("opencv5")
    assert set(model.stages[1]) == set(MODEL.stages[1])
    assert (MODEL.stages[0], MODEL.colour_stages[0]) == (model.stages[0], model.colour_stages[0])
    assert set(model.colour_stages[1]) == set(MODEL.colour_stages[1])
    assert FOUR.stages == (("fx", "fy", "k1"), ("fx", "fy", "cx", "cy", "k1", "k2"))
