"""The panoramas: their formulas at places that are known, and what has no place. tests/contracts shows the rest."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named

FOCAL = 100.0
PARAMETERS = np.array([FOCAL, FOCAL, 300.0, 200.0])
QUARTER = np.pi / 2


def project(name, *points):
    return model_named(name).project(PARAMETERS, np.array(points, dtype=float))


@pytest.mark.parametrize(
    ("name", "right", "down"),
    [("cylinder", (QUARTER, 0), (0, 1)), ("equirectangular", (QUARTER, 0), (0, QUARTER / 2)),
     ("stereographic", (2, 0), (0, 2 * np.tan(QUARTER / 4)))],
)  # fmt: skip
def test_rays_to_the_right_and_down_stand_where_the_formula_says(name, right, down):
    found = project(name, [2, 0, 0], [0, 3, 3], [0, 0, 1])
    expected = 100 * np.array([right, down, (0, 0)]) + [300, 200]
    np.testing.assert_allclose(found.pixels, expected, atol=1e-12)  # rounding


@pytest.mark.parametrize("name", ["cylinder", "equirectangular", "stereographic"])
def test_a_view_reaches_around_to_just_beside_the_seam(name):
    point = [np.sin(3.1), 0.0, np.cos(3.1)]
    found = project(name, point)
    assert found.valid.all()
    back = model_named(name).unproject(PARAMETERS, found.pixels)
    np.testing.assert_allclose(back.directions[0], point, atol=1e-12)  # rounding, at 60 px from the seam


@pytest.mark.parametrize(
    ("name", "x", "y"),
    [("cylinder", 3.2, 0), ("cylinder", -3.2, 0), ("equirectangular", 3.2, 0), ("equirectangular", 0, 1.6)],
)
def test_pixels_beyond_the_seam_or_the_pole_have_no_ray(name, x, y):
    found = model_named(name).unproject(PARAMETERS, np.array([[300 + 100 * x, 200 + 100 * y], [300, 200]]))
    assert found.valid.tolist() == [False, True]
    assert np.isnan(found.directions[0]).all()


@pytest.mark.parametrize(("name", "point"), [("cylinder", [0, 1, 0]), ("equirectangular", [0, -1, 0])])
def test_straight_up_and_down_have_no_azimuth(name, point):
    assert not project(name, point).valid.any()


def test_upright_lines_are_straight_in_a_cylinder():
    line = project("cylinder", *[[1.0, y, 0.5] for y in np.linspace(-2, 2, 5)]).pixels
    np.testing.assert_allclose(line[:, 0], line[0, 0], atol=1e-12)
    np.testing.assert_allclose(np.diff(line[:, 1], 2), 0, atol=1e-12)


def test_small_circles_stay_circles_in_a_stereographic_view():
    axis = np.array([0.6, 0.3, -0.2]) / 0.7
    across = np.linalg.svd(axis[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, 50)[:, None]
    circle = axis + 1e-4 * (np.cos(angle) * across[0] + np.sin(angle) * across[1])
    pixels = project("stereographic", *circle).pixels
    radii = np.linalg.norm(pixels - pixels[:-1].mean(axis=0), axis=1)
    np.testing.assert_allclose(radii, radii.mean(), rtol=2e-4)  # circles of 1e-4 rad are round to first order


@pytest.mark.parametrize("name", ["cylinder", "equirectangular", "stereographic"])
@pytest.mark.parametrize("fov_deg", [60, 200, 340])
def test_the_half_width_is_where_the_edge_of_the_field_of_view_stands(name, fov_deg):
    edge = np.radians(fov_deg / 2)
    found = project(name, [np.sin(edge), 0.0, np.cos(edge)]).pixels[0, 0]
    assert found == pytest.approx(300 + FOCAL * model_named(name).half_width(2 * edge), rel=1e-12)
