"""Views about the horizontal axis: rows are planes through it, and places are known. tests/contracts shows the rest."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named

PARAMETERS = np.array([100.0, 100.0, 300.0, 200.0])
EIGHTH = np.pi / 4


@pytest.mark.parametrize(
    ("name", "right", "below"), [("cylinder_x", (1, 0), (0, EIGHTH)), ("latlon_x", (EIGHTH, 0), (0, EIGHTH))]
)
def test_rays_to_the_right_and_below_stand_where_the_formula_says(name, right, below):
    points = np.array([[2.0, 0, 2], [0, 3, 3], [0, 0, 1]])
    found = model_named(name).project(PARAMETERS, points)
    np.testing.assert_allclose(found.pixels, 100 * np.array([right, below, (0, 0)]) + [300, 200], atol=1e-12)


@pytest.mark.parametrize("name", ["cylinder_x", "latlon_x"])
def test_a_plane_through_the_horizontal_axis_is_a_row(name):
    points = np.array([[x, 0.4, -0.3] for x in np.linspace(-3, 3, 7)])
    rows = model_named(name).project(PARAMETERS, points).pixels[:, 1]
    np.testing.assert_allclose(rows, 200 + 100 * np.arctan2(0.4, -0.3), atol=1e-12)  # behind the camera, too


@pytest.mark.parametrize(("name", "pixel"), [("latlon_x", (300 + 158, 200)), ("cylinder_x", (300, 200 + 315))])
def test_pixels_beyond_the_axis_and_the_seam_have_no_ray(name, pixel):
    assert not model_named(name).unproject(PARAMETERS, np.array([pixel], float)).valid.any()


@pytest.mark.parametrize("name", ["cylinder_x", "latlon_x"])
def test_the_axis_itself_has_no_place(name):
    assert not model_named(name).project(PARAMETERS, np.array([[1.0, 0, 0], [-1, 0, 0]])).valid.any()
