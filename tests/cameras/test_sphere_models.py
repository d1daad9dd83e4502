"""Lenses by way of spheres: their formulas by hand, the identities between them, folds, inverses and focal length.

That they meet golden vectors, and what every model promises, stands in tests/contracts/test_models.py.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.cameras.refit import same_lens

CORE = [500.0, 505.0, 319.5, 241.25]
SIZE = (640, 480)
NAMES = ("ucm", "eucm", "double_sphere", "mei")


def rays(theta, azimuth):
    return np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)


def camera(name, *values):
    model = MODELS[name]
    return Camera(model, SIZE, np.array([*CORE, *values, *(0.0,) * (len(model.parameter_names) - 4 - len(values))]))


def angles_between(directions, points):
    return np.arctan2(np.linalg.norm(np.cross(directions, points), axis=1), np.sum(directions * points, axis=1))


def round_trip_error(own, margin):
    """The largest angle (rad) over the domain, but for a margin (rad) at its end, where the inverse has no slope."""
    theta = np.concatenate(
        [np.geomspace(1e-9, 1e-3, 20), np.linspace(1e-3, own.model.domain(own.parameters).max_theta - margin, 300)]
    )
    points = rays(*map(np.ravel, np.meshgrid(theta, np.linspace(0, 6, 7))))
    found = own.unproject(own.project(points).pixels)
    assert found.valid.all()
    return angles_between(found.directions, points).max()


def place_by_hand(name, values, theta):
    """The radius on the plane, by the construction with spheres rather than by the formula."""
    x, z = np.sin(theta), np.cos(theta)
    if name == "double_sphere":
        xi, alpha = values
        x, z = x / np.hypot(x, z + xi), (z + xi) / np.hypot(x, z + xi)  # onto the second sphere
        return x / (z + alpha / (1 - alpha)) / (1 - alpha)
    if name == "mei":
        return x / (z + values[0])
    alpha, beta = (*values, 1.0)[:2]
    stretch = 1 / np.sqrt(beta * x * x + z * z)  # onto the ellipsoid
    return stretch * x / (stretch * z + alpha / (1 - alpha)) / (1 - alpha)


@pytest.mark.parametrize(
    ("name", "values"),
    [("ucm", (0.6,)), ("eucm", (0.59, 1.13)), ("double_sphere", (-0.24, 0.567)), ("mei", (1.2,)), ("mei", (0.7,))],
)
def test_a_point_goes_to_the_sphere_and_from_there_to_the_plane(name, values):
    theta = np.radians(np.arange(0, 100, 5.0))
    found = camera(name, *values).project(3 * rays(theta, np.zeros_like(theta))).pixels
    np.testing.assert_allclose(found[:, 0], 500 * place_by_hand(name, values, theta) + 319.5, atol=1e-9)
    np.testing.assert_allclose(found[:, 1], 241.25, atol=1e-9)


def test_mei_is_opencvs_omnidirectional_lens():
    own = camera("mei", 1.2, -0.12, 0.05, 0.0005, -0.0006)
    rng = np.random.default_rng(3)
    points = rays(rng.uniform(0, np.radians(95), 500), rng.uniform(0, 2 * np.pi, 500))
    if not hasattr(cv2, "omnidir"):
        pytest.skip("this OpenCV has no omnidir")
    matrix, rest = np.array([[500, 0, 319.5], [0, 505, 241.25], [0, 0, 1.0]]), np.zeros(3)
    theirs, _ = cv2.omnidir.projectPoints(
        points[:, None], rest, rest, matrix, 1.2, np.array([-0.12, 0.05, 0.0005, -0.0006])
    )
    ours = own.project(points)
    assert ours.valid.all()
    np.testing.assert_allclose(ours.pixels, theirs.reshape(-1, 2), atol=1e-9)


@given(alpha=st.floats(0.0, 0.95), beta=st.floats(0.3, 3.0))
def test_ucm_and_eucm_are_inverted_over_their_whole_domain(alpha, beta):
    assert round_trip_error(camera("ucm", alpha), 1e-3) < 1e-9
    assert round_trip_error(camera("eucm", alpha, beta), 1e-3) < 1e-9


@given(xi=st.floats(-0.9, 1.0), alpha=st.floats(0.0, 0.95))
def test_double_sphere_is_inverted_over_its_whole_domain(xi, alpha):
    assert round_trip_error(camera("double_sphere", xi, alpha), 1e-3) < 1e-9


@given(xi=st.floats(0.0, 4.0), k1=st.floats(-0.2, 0.2))
def test_mei_is_inverted_over_its_whole_domain(xi, k1):
    assert round_trip_error(camera("mei", xi, k1, 0.0, 0.0005, -0.0006), 1e-3) < 1e-9


@pytest.mark.parametrize(
    ("name", "values", "cosine"),
    [
        ("ucm", (0.8,), -0.25),
        ("ucm", (0.3,), -3 / 7),
        ("mei", (0.4,), -0.4),
        ("mei", (2.5,), -0.4),
        ("double_sphere", (0.0, 0.8), -0.25),
        ("double_sphere", (-0.2, 0.6), -(2 / 3 - 0.2) / np.sqrt(2 * 2 / 3 * -0.2 + 0.04 + 1)),
    ],
)
def test_a_lens_ends_where_its_paper_says(name, values, cosine):
    own = camera(name, *values)
    last = own.model.domain(own.parameters).max_theta
    assert own.project(rays(np.array([last - 1e-5, last + 1e-5]), np.zeros(2))).valid.tolist() == [True, False]
    assert np.cos(last) == pytest.approx(cosine, abs=1e-7)  # at a fold the radius has no slope


@given(alpha=st.floats(0.01, 0.95))
def test_a_unified_lens_is_the_same_in_every_model_that_has_it(alpha):
    own = camera("ucm", alpha)
    others = {each.model.name: each for each in same_lens(own)}
    assert set(others) == set(NAMES)
    theta = np.linspace(0, own.model.domain(own.parameters).max_theta - 1e-3, 50)
    points = rays(theta, 3 * theta)
    for each in others.values():
        found = each.project(points)
        assert found.valid.all()
        np.testing.assert_allclose(found.pixels, own.project(points).pixels, rtol=1e-10)


@pytest.mark.parametrize(
    ("start", "expected"),
    [
        (("double_sphere", 0.7, 0.0), {"double_sphere", "mei", "ucm", "eucm"}),
        (("double_sphere", -0.3, 0.0), {"double_sphere"}),
        (("double_sphere", 0.2, 0.5), {"double_sphere"}),
        (("eucm", 0.6, 1.0), {"eucm", "ucm", "double_sphere", "mei"}),
        (("eucm", 0.6, 1.2), {"eucm"}),
        (("mei", 1.3), {"mei", "ucm", "eucm", "double_sphere"}),
        (("mei", 1.3, -0.1), {"mei"}),
        (("mei", 0.0, -0.1, 0.02), {"mei", "opencv4"}),
        (("division", 0.0), {"division", "pinhole", "ucm", "eucm", "double_sphere", "mei", "opencv4"}),
        (("fov", 0.0), {"fov", "pinhole", "ucm", "eucm", "double_sphere", "mei", "division", "opencv4"}),
    ],
)
def test_exactly_the_models_are_named_that_are_the_same_lens(start, expected):
    name, *values = start
    own = camera(name, *values)
    found = same_lens(own)
    assert found[0] is own
    assert {each.model.name for each in found} == expected
    points = rays(np.linspace(0, 1.2, 30), np.linspace(0, 6, 30))
    for each in found:
        np.testing.assert_allclose(each.project(points).pixels, own.project(points).pixels, rtol=1e-10)


def test_the_focal_length_of_a_mirror_is_known_better_than_its_parameter():
    model = MODELS["mei"]
    parameters = np.array([1000.0, 1010.0, 320.0, 240.0, 1.0, 0, 0, 0, 0])
    covariance = np.zeros((9, 9))
    # fx and ξ vary together, their quotient does not
    covariance[np.ix_([0, 4], [0, 4])] = np.outer([50.0, 0.1], [50.0, 0.1])
    lengths, stds = Camera(model, SIZE, parameters, covariance).focal_lengths()
    np.testing.assert_allclose(lengths, [500.0, 505.0], rtol=1e-12)
    np.testing.assert_allclose(stds, [0.0, 25.25], atol=1e-3)
    np.testing.assert_array_equal(Camera(model, SIZE, parameters).focal_lengths()[1], 0)


def test_what_other_programs_call_them_is_understood():
    assert model_named("ds").name == "double_sphere"
    assert model_named("omni").name == model_named("omnidir").name == "mei"
