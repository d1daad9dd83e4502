"""The spline over the stereographic plane against an implementation by scipy's splines and numbers of mrcal's.

Contracts of every lens model are in tests/contracts.
"""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera, reframed
from camcal.errors import InvalidInput
from camcal.solve.differentiate import central_jacobian

SPLINED = MODELS["splined_stereographic"]
SIZE = (1920, 1080)
MRCAL = {
    2: [
        [1051.4686820764418, 364.19547655111126],
        [1520.293591791998, 791.6337066783237],
        [487.83649335511586, 1098.553224551426],
        [967.25625, 547.24],
    ],
    3: [
        [1053.0740268060786, 365.3808240971937],
        [1521.81125621426, 791.1559593362937],
        [489.2289874188788, 1099.9534546933207],
        [967.521875, 547.24],
    ],
}


def lens(knots=(16, 11), fov_x_deg=150.0, degree=3, spread=0.01, seed=3):
    model = SPLINED.configured({"knots": list(knots), "fov_x_deg": fov_x_deg, "degree": degree})
    parameters = model.start(SIZE, 900.0)
    parameters[4:] = np.random.default_rng(seed).normal(0, spread, len(parameters) - 4)
    return model, parameters


def points_within(degrees, count=300, seed=4):
    rng = np.random.default_rng(seed)
    theta, azimuth = rng.uniform(0, np.radians(degrees), count), rng.uniform(0, 2 * np.pi, count)
    directions = np.stack([np.sin(theta) * np.cos(azimuth), np.sin(theta) * np.sin(azimuth), np.cos(theta)], axis=-1)
    return directions * rng.uniform(0.5, 3, count)[:, None]


@pytest.mark.parametrize("degree", [2, 3])
def test_it_is_a_tensor_product_of_uniform_splines(degree):
    model, parameters = lens(degree=degree)
    points = points_within(45)
    (columns, rows), scale = model.knots, model.grid.per_unit
    u = 2 * points[:, :2] / (np.linalg.norm(points, axis=1) + points[:, 2])[:, None]
    knots = parameters[4:].reshape(rows, columns, 2)

    def basis(place, count):
        # the spline of knot i is centred on i
        return BSpline.design_matrix(
            place * scale + (count - 1) / 2, np.arange(count + degree + 1) - (degree + 1) / 2, degree
        ).toarray()

    moved = np.einsum("nr,nc,rck->nk", basis(u[:, 1], rows), basis(u[:, 0], columns), knots)
    expected = (u + moved) * parameters[:2] + parameters[2:4]
    np.testing.assert_allclose(model.project(parameters, points).pixels, expected, atol=1e-10)


def test_it_is_that_of_mrcal():
    # mrcal 2.2, LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=7_Ny=6_fov_x_deg=100 and order=2, knots 0.001 (i mod 17)
    points = np.array([[0.1, -0.2, 1.0], [0.9, 0.4, 1.3], [-0.7, 0.8, 1.1], [0.0, 0.0, 2.0]])
    for degree, expected in MRCAL.items():
        model = SPLINED.configured({"knots": [7, 6], "fov_x_deg": 100, "degree": degree})
        parameters = np.concatenate([[900.0, 905.0, 960.0, 540.0], 0.001 * (np.arange(84) % 17)])
        np.testing.assert_allclose(model.project(parameters, points).pixels, expected, atol=1e-9)


def test_derivatives_are_by_the_knots_around_a_point_only():
    model, parameters = lens()
    points = points_within(50, 20)
    found = model.project_with_jacobians(parameters, points)
    assert found.d_parameters.shape == (20, 2, 4 + 32)
    numeric = central_jacobian(lambda p: model.project(p, points).pixels, parameters, 1e-4)
    np.testing.assert_allclose(found.by_parameters(len(parameters)), numeric, rtol=1e-8, atol=2e-8)


@pytest.mark.parametrize("degree", [2, 3])
def test_pixels_of_strongly_bent_lenses_have_their_rays(degree):
    """A perspective lens of 120° stands in the same plane as a fisheye of half its focal length."""
    model = SPLINED.configured({"knots": [30, 30], "fov_x_deg": 130, "degree": degree})
    places = model.grid.places()
    radius = np.linalg.norm(places, axis=1)
    theta = 2 * np.arctan(radius / 2)
    end = np.radians(62)  # from there on the radius grows as it does there
    perspective = np.tan(np.minimum(theta, end)) + np.maximum(theta - end, 0) / np.cos(end) ** 2
    parameters = model.start(SIZE, 500.0)
    parameters[4:] = ((perspective / radius)[:, None] * places - places).ravel()
    points = points_within(58)
    pixels = model.project(parameters, points)
    assert pixels.valid.all()
    found = model.unproject(parameters, pixels.pixels)
    assert found.valid.all()
    apart = np.linalg.norm(np.cross(found.directions, points), axis=1) / np.linalg.norm(points, axis=1)
    assert apart.max() < 1e-9


def test_a_lens_ends_where_it_folds_and_where_its_knots_end():
    model, parameters = lens(spread=0.0)
    beyond = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, -0.3], [0.2, 0.1, 1.0]])
    np.testing.assert_array_equal(model.project(parameters, beyond).valid, [False, False, True])
    assert model.project_with_jacobians(parameters, beyond, within_domain=False).valid.tolist() == [False, True, True]
    folded = parameters.copy()
    grid = folded[4:].reshape(model.knots[1], model.knots[0], 2)
    grid[:, 12:, 0] -= 1.0  # the columns of knots to the right lie over those before them
    right, left = np.array([[1.0, 0.0, 0.9]]), np.array([[-1.0, 0.0, 0.9]])
    assert not model.project(folded, right).valid.any()
    assert model.project(folded, left).valid.all()
    pixels = model.project(folded, left).pixels
    np.testing.assert_allclose(model.unproject(folded, pixels).directions, left / np.linalg.norm(left), atol=1e-9)


def test_a_resized_and_cropped_image_has_the_same_knots():
    model, parameters = lens()
    camera = Camera(model, SIZE, parameters)
    half = reframed(camera, (900, 500), (0.5, 0.5), (10.0, 20.0))
    np.testing.assert_array_equal(half.parameters[4:], parameters[4:])
    points = points_within(40)
    expected = (camera.project(points).pixels + 0.5) * 0.5 - 0.5 - [10.0, 20.0]
    np.testing.assert_allclose(half.project(points).pixels, expected, atol=1e-10)


def test_it_goes_by_a_short_name_and_by_its_knots():
    assert model_named("splined") is SPLINED
    assert lens(knots=(16, 11))[0] == lens(knots=(16, 11))[0] != lens(knots=(16, 12))[0]


@pytest.mark.parametrize(
    ("configuration", "words"),
    [
        ({"knots": [3, 10]}, "knots"),
        ({"knots": [10.5, 10]}, "knots"),
        ({"knots": 10}, "knots"),
        ({"fov_x_deg": 0}, "fov_x_deg"),
        ({"fov_x_deg": "wide"}, "fov_x_deg"),
        ({"degree": 4}, "degree"),
        ({"fov_x": 90}, "unknown key 'fov_x'. Did you mean 'fov_x_deg'"),
    ],
)
def test_knots_that_are_none_are_refused(configuration, words):
    with pytest.raises(InvalidInput) as error:
        SPLINED.configured(configuration)
    assert words in error.value.message
