"""The Brown family: the formula against OpenCV, the inverse on wide and folding lenses."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from camcal.cameras.brown import MODELS
from camcal.cameras.catalogue import model_named
from camcal.parsing import LARGEST

FAMILY = {model.name: model for model in MODELS}
COEFFICIENTS = FAMILY["opencv14"].parameter_names[4:]
VALUES = (-0.28, 0.07, 0.002, -0.003, 0.01, 0.02, -0.01, 0.003, 0.01, -0.002, 0.005, 0.001, 0.12, -0.15)
LENS = {"fx": 500.0, "fy": 505.0, "cx": 319.5, "cy": 241.25} | dict(zip(COEFFICIENTS, VALUES, strict=True))
every_brown = pytest.mark.parametrize("model", MODELS, ids=FAMILY)


def parameters_of(model, **changes):
    values = LENS | changes
    return np.array([values[name] for name in model.parameter_names])


def rays(theta, azimuth):
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)


def rays_within(theta, count=2000, seed=3):
    rng = np.random.default_rng(seed)
    return rays(rng.uniform(0, theta, count), rng.uniform(0, 2 * np.pi, count))


def round_trip_error(model, parameters, points):
    """The largest angle (rad) between rays and what comes back of them; NaN if one does not."""
    found = model.unproject(parameters, model.project(parameters, points).pixels)
    return np.linalg.norm(np.cross(found.directions, points), axis=1).max()


@every_brown
def test_projection_agrees_with_opencv(model):
    parameters = parameters_of(model)
    points = rays_within(np.radians(40)) * 3.0
    fx, fy, cx, cy, *coefficients = parameters
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    expected, *_ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(coefficients or [0.0] * 4))
    ours = model.project(parameters, points)
    assert ours.valid.all()
    np.testing.assert_allclose(ours.pixels, expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12])
def test_a_longer_model_with_zeros_is_the_shorter_one(count):
    short = next(model for model in MODELS if len(model.coefficients) == count)
    long = FAMILY["opencv14"]
    points = rays_within(np.radians(40))
    padded = parameters_of(long, **dict.fromkeys(COEFFICIENTS[count:], 0.0))
    np.testing.assert_allclose(
        long.project(padded, points).pixels, short.project(parameters_of(short), points).pixels, atol=1e-11
    )


def test_coefficients_keep_the_order_of_opencv():
    assert FAMILY["opencv5"].parameter_names == ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    assert [len(model.coefficients) for model in MODELS] == [0, 4, 5, 8, 12, 14]


@every_brown
def test_points_beside_and_behind_the_camera_are_invalid(model):
    projection = model.project(parameters_of(model), np.array([[1.0, 0.2, 0.0], [0.1, 0.2, -1.0], [0.1, 0.2, 1.0]]))
    np.testing.assert_array_equal(projection.valid, [False, False, True])
    assert np.isnan(projection.pixels[:2]).all()


def test_barrel_distortion_folds_where_its_radius_stops_growing():
    model = FAMILY["opencv4"]
    domain = model.domain(parameters_of(model, k1=-0.3, k2=0.0, p1=0.0, p2=0.0))
    fold = 1 / np.sqrt(0.9)  # d(r - 0.3 r³)/dr = 0
    assert domain.max_theta == pytest.approx(np.arctan(fold), abs=1e-12)
    assert domain.max_radius_px == pytest.approx(500 * fold * (1 - 0.3 * fold**2), abs=1e-9)


def test_tangential_terms_bring_the_fold_nearer_and_the_domain_ends_there():
    model = FAMILY["opencv4"]
    parameters = parameters_of(model, fx=1.0, fy=1.0, cx=0.0, cy=0.0, k1=-0.3, k2=0.0, p1=0.03, p2=0.04)
    radius = np.tan(model.domain(parameters).max_theta)
    assert radius < 0.95 / np.sqrt(0.9)
    worst = -np.array([0.8, 0.6])  # towards (-p2, -p1)
    points = np.append(worst * radius, 1.0)[None]
    slope = model.project_with_jacobians(parameters, points, within_domain=False).d_point[0, :, :2]
    # there and nowhere nearer does the map of the plane lose a dimension
    assert np.linalg.svd(slope)[1].min() == pytest.approx(0, abs=1e-9)


def test_a_pole_of_the_rational_model_ends_the_domain():
    model = FAMILY["opencv8"]
    zeros = dict.fromkeys(COEFFICIENTS, 0.0)
    domain = model.domain(parameters_of(model, **(zeros | {"k4": -0.25})))
    assert domain.max_theta == pytest.approx(np.arctan(2.0), abs=1e-12)
    assert domain.max_radius_px == np.inf


@pytest.mark.parametrize("tiny", [1e-300, -1e-300, 1e-30, 0.0])
def test_a_tiny_last_coefficient_does_not_disturb_the_domain(tiny):
    model = FAMILY["opencv8"]
    zeros = dict.fromkeys(COEFFICIENTS, 0.0)
    domain = model.domain(parameters_of(model, **(zeros | {"k1": -0.3, "k3": tiny, "k6": tiny})))
    assert np.tan(domain.max_theta) == pytest.approx(1 / np.sqrt(0.9), rel=1e-9)


def test_a_coefficient_that_is_no_number_leaves_no_domain():
    model = FAMILY["opencv5"]
    parameters = parameters_of(model, k2=np.nan)
    assert model.domain(parameters).max_theta == 0.0
    assert not model.project(parameters, np.array([[0.0, 0.1, 1.0]])).valid.any()


def test_tilted_sensor_does_not_see_behind_itself():
    model = FAMILY["opencv14"]
    parameters = parameters_of(model, **dict.fromkeys(COEFFICIENTS, 0.0) | {"tau_y": 0.5})
    # the plane of the sensor meets the plane Z = 1 at x = 1 / tan(0.5)
    x = 1 / np.tan(0.5) * np.array([-1.01, -0.99, 0.99, 1.01])
    points = np.stack([x, np.zeros(4), np.ones(4)], axis=1)
    valid = model.project(parameters, points).valid
    assert valid[1]
    assert valid[2]
    assert valid.sum() == 3


@pytest.fixture(scope="module")
def wide_lens():
    """An opencv8 lens whose image radius is that of an equidistant fisheye up to 82°, and its coefficients."""
    theta = np.linspace(0.01, np.radians(82), 400)
    r = np.tan(theta)
    powers = np.stack([r**2, r**4, r**6], axis=1)
    weight = 1 / (r**4 + 1e-3)
    system = np.hstack([r[:, None] * powers, -theta[:, None] * powers]) * weight[:, None]
    k1, k2, k3, k4, k5, k6 = np.linalg.lstsq(system, (theta - r) * weight, rcond=None)[0]
    model = model_named("opencv8")
    changes = {"k1": k1, "k2": k2, "k3": k3, "k4": k4, "k5": k5, "k6": k6, "p1": 3e-4, "p2": -2e-4}
    return model, parameters_of(model, **changes)


def test_unprojection_is_exact_on_a_wide_lens(wide_lens):
    model, parameters = wide_lens
    assert model.domain(parameters).max_theta > np.radians(82)
    assert round_trip_error(model, parameters, rays_within(np.radians(82), 20000)) < 1e-9


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("opencv4", {"k1": -0.3, "k2": 0.0}),
        ("opencv4", {"k1": -0.4, "k2": -0.2, "p1": 0.01, "p2": -0.02}),
        ("opencv5", {"k1": 0.4, "k2": -0.3, "k3": -0.1}),
        ("opencv14", {"k1": -0.35, "k2": 0.02, "k3": -0.02}),
    ],
)
def test_unprojection_is_exact_close_to_the_fold(name, changes, gap):
    model = FAMILY[name]
    parameters = parameters_of(model, **changes)
    limit = model.domain(parameters).max_theta
    assert limit < np.radians(60)
    azimuth = np.linspace(0, 2 * np.pi, 100)
    # 1e-16 of rounding over a slope of about `gap`
    assert round_trip_error(model, parameters, rays(np.full(100, limit * (1 - gap)), azimuth)) < 1e-9


def test_pixels_beyond_the_fold_have_no_ray():
    model = FAMILY["opencv5"]
    parameters = parameters_of(model, k1=-0.3, k2=0.0, k3=0.0, p1=0.0, p2=0.0, fy=500.0)
    radius = model.domain(parameters).max_radius_px
    pixels = np.array([[319.5 + radius - 1e-3, 241.25], [319.5 + radius + 1e-3, 241.25]])
    found = model.unproject(parameters, pixels)
    np.testing.assert_array_equal(found.valid, [True, False])
    assert np.isnan(found.directions[1]).all()


COEFFICIENT = st.floats(-0.5, 0.5)
SMALL = st.floats(-0.02, 0.02)
UNTILTED = st.tuples(*[COEFFICIENT] * 2, *[SMALL] * 2, *[COEFFICIENT] * 4, *[SMALL] * 4)
ANGLE = st.floats(-0.2, 0.2)
SHARE, AZIMUTH = st.floats(0, 0.999), st.floats(0, 2 * np.pi)


@given(UNTILTED, SHARE, AZIMUTH)
def test_any_lens_is_inverted_over_its_whole_domain(coefficients, share, azimuth):
    model = FAMILY["opencv12"]
    parameters = np.array([500.0, 510.0, 320.0, 240.0, *coefficients])
    theta = share * model.domain(parameters).max_theta
    assert round_trip_error(model, parameters, rays(np.array([theta]), np.array([azimuth]))) < 1e-9


@given(UNTILTED, ANGLE, ANGLE, SHARE, AZIMUTH)
def test_any_tilted_lens_is_inverted_away_from_its_horizon(coefficients, tau_x, tau_y, share, azimuth):
    model = FAMILY["opencv14"]
    parameters = np.array([500.0, 510.0, 320.0, 240.0, *coefficients, tau_x, tau_y])
    # towards the horizon of the sensor a pixel holds ever more of the plane
    theta = share * min(model.domain(parameters).max_theta, np.radians(45))
    point = rays(np.array([theta]), np.array([azimuth]))
    assume(model.project(parameters, point).valid.all())  # a rational lens may reach the horizon even so
    assert round_trip_error(model, parameters, point) < 1e-9


@given(UNTILTED, ANGLE, ANGLE, st.floats(0, 1200), st.floats(-300, 800))
def test_a_pixel_with_a_ray_is_where_the_ray_projects(coefficients, tau_x, tau_y, u, v):
    model = FAMILY["opencv14"]
    parameters = np.array([500.0, 510.0, 320.0, 240.0, *coefficients, tau_x, tau_y])
    found = model.unproject(parameters, np.array([[u, v]]))
    assume(found.valid.all())
    back = model.project(parameters, found.directions)
    assert back.valid.all()
    np.testing.assert_allclose(back.pixels, [[u, v]], atol=1e-8)  # 1e-12 on the plane, 500 px per unit, with slack


def test_priors_follow_the_power_of_the_radius():
    spread = dict(zip(COEFFICIENTS, FAMILY["opencv14"].prior_std((1600, 1200), 2000.0)[4:], strict=True))
    assert {name: spread[name] for name in ("k1", "k2", "k3")} == {"k1": 4.0, "k2": 16.0, "k3": 64.0}
    assert {name: spread[name] for name in ("k4", "k5", "k6")} == {"k4": 4.0, "k5": 16.0, "k6": 64.0}
    assert {name: spread[name] for name in ("p1", "p2", "s1", "s3")} == dict.fromkeys(("p1", "p2", "s1", "s3"), 2.0)
    assert {name: spread[name] for name in ("s2", "s4", "tau_x")} == {"s2": 8.0, "s4": 8.0, "tau_x": 1.0}


def test_focal_length_and_first_radial_term_are_freed_first_then_what_moves_the_principal_point():
    first, then = {"fx", "fy", "k1"}, {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"}
    for model in MODELS:
        assert [set(stage) for stage in model.stages] == [names & set(model.parameter_names) for names in (first, then)]


def test_colours_differ_in_size_and_place_first_then_in_the_lowest_terms():
    first, then = {"fx", "fy", "cx", "cy"}, {"fx", "fy", "cx", "cy", "k1", "p1", "p2"}
    for model in MODELS:
        assert [set(stage) for stage in model.colour_stages] == [
            names & set(model.parameter_names) for names in (first, then)
        ]


def test_a_tilt_of_a_right_angle_is_the_most_that_a_file_may_have():
    limits = FAMILY["opencv14"].limits
    assert limits["tau_x"] == limits["tau_y"] == (-np.pi / 2, np.pi / 2)
    assert limits["k1"] == (-LARGEST, LARGEST)
