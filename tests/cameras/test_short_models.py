"""Lenses of one formula: by hand, over their whole domain, and as their parameter goes to nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sphere_models import camera, rays, round_trip_error

from camcal.cameras.catalogue import MODELS

FORMULAS = {
    ("orthographic",): np.sin,
    ("equisolid",): lambda theta: 2 * np.sin(theta / 2),
    ("fov", 0.93): lambda theta: np.arctan(2 * np.tan(theta) * np.tan(0.465)) / 0.93,
    ("division", -0.2): lambda theta: (np.sqrt(1 + 0.8 * np.tan(theta) ** 2) - 1) / (0.4 * np.tan(theta)),
}


@pytest.mark.parametrize("own", FORMULAS, ids=str)
def test_the_radius_is_the_formula_of_the_angle(own):
    theta = np.radians(np.arange(5, 90, 5.0))
    found = camera(*own).project(0.3 * rays(theta, np.full_like(theta, np.pi / 2))).pixels
    np.testing.assert_allclose(found[:, 1], 505 * FORMULAS[own](theta) + 241.25, atol=1e-9)


@given(omega=st.floats(0.0, 3.0))
def test_fov_is_inverted_over_its_whole_domain(omega):
    assert round_trip_error(camera("fov", omega), 1e-4) < 1e-9


@given(value=st.floats(-2.0, 2.0))
def test_division_is_inverted_over_its_whole_domain(value):
    assert round_trip_error(camera("division", value), 1e-3) < 1e-9


def test_fisheyes_without_parameters_are_inverted_over_their_whole_domain():
    assert round_trip_error(camera("orthographic"), 1e-4) < 1e-9
    assert round_trip_error(camera("equisolid"), 1e-4) < 1e-9


@pytest.mark.parametrize(("name", "degrees"), [("fov", 90), ("division", 90), ("orthographic", 90), ("equisolid", 180)])
def test_they_end_where_their_formula_does(name, degrees):
    values = {"fov": (0.93,), "division": (-0.2,)}.get(name, ())
    own = camera(name, *values)
    assert np.degrees(own.model.domain(own.parameters).max_theta) == pytest.approx(degrees, abs=1e-5)


def test_a_pincushion_that_divides_ends_at_its_fold():
    own = camera("division", 0.25)
    assert np.tan(own.model.domain(own.parameters).max_theta) == pytest.approx(1.0, abs=1e-7)  # Z² = 4 λ ρ²


@pytest.mark.parametrize("power", range(1, 13))
def test_fov_has_no_step_where_its_series_begins(power):
    theta = np.radians(np.arange(0, 85, 5.0))
    points = rays(theta, np.ones_like(theta))
    straight = camera("fov", 0.0).project(points).pixels
    found = MODELS["fov"].project_with_jacobians(camera("fov", 10.0**-power).parameters, points)
    # it departs from a pinhole with ω², by r (1 + 4 r²) ω²/12 and less
    bound = 505 * 10.0 ** (-2 * power) * np.tan(theta).max() ** 3
    assert np.abs(found.pixels - straight).max() < bound + 1e-9
    near = MODELS["fov"].project(camera("fov", 10.0**-power * 1.001).parameters, points).pixels
    np.testing.assert_allclose(
        found.d_parameters[:, :, 4] * 10.0**-power * 0.001, near - found.pixels, rtol=2e-3, atol=1e-9
    )


@pytest.mark.parametrize("angle", 10.0 ** -np.arange(1, 13))
def test_fov_is_exact_near_the_axis(angle):
    own, points = camera("fov", 0.93), rays(np.array([angle]), np.array([0.3]))
    expected = np.arctan(2 * np.tan(0.465) * np.tan(angle)) / 0.93
    found = (own.project(points).pixels - [319.5, 241.25])[0] / [500, 505]
    assert np.hypot(*found) == pytest.approx(expected, rel=1e-9, abs=1e-15)
