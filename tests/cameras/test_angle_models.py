"""Lenses by polynomials of every power: by hand, over their whole domain, and by the files of those who have them."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sphere_models import CORE, SIZE, angles_between, camera, rays, round_trip_error

from camcal.cameras.catalogue import model_named
from camcal.errors import InvalidInput
from camcal.formats import cameras
from camcal.formats.cameras.ocamcalib import polynomial_camera
from camcal.formats.cameras.record import Given

TERMS = (0.03, -0.05, 0.01, -0.002)
small = st.floats(-0.05, 0.05)


def test_the_radius_of_ftheta_is_a_polynomial_of_the_angle():
    theta = np.radians(np.arange(0, 120, 5.0))
    found = camera("ftheta", *TERMS).project(2 * rays(theta, np.zeros_like(theta))).pixels[:, 0]
    radius = theta + 0.03 * theta**2 - 0.05 * theta**3 + 0.01 * theta**4 - 0.002 * theta**5
    np.testing.assert_allclose(found, 500 * radius + 319.5, atol=1e-9)


def test_the_angle_of_its_inverse_is_a_polynomial_of_the_radius():
    radius = np.linspace(0, 1.8, 30)
    pixels = np.column_stack([500 * radius + 319.5, np.full(30, 241.25)])
    theta = radius + 0.03 * radius**2 - 0.05 * radius**3 + 0.01 * radius**4 - 0.002 * radius**5
    found = camera("ftheta_inverse", *TERMS).unproject(pixels).directions
    assert angles_between(found, rays(theta, np.zeros(30))).max() < 1e-12


def test_the_depth_of_a_ray_of_ocam_is_a_polynomial_of_the_radius():
    own = camera("ocam", -0.3, -0.01, -0.02, 0.002, -0.001)
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 7), np.linspace(-0.9, 0.9, 7))
    x, y = x.ravel(), y.ravel()
    radius = np.hypot(x, y)
    pixels = np.column_stack([500 * (x + 0.002 * y) + 319.5, 505 * (y - 0.001 * x) + 241.25])
    points = np.column_stack([x, y, 1 - 0.3 * radius**2 - 0.01 * radius**3 - 0.02 * radius**4])
    np.testing.assert_allclose(own.project(points).pixels, pixels, atol=1e-9)
    assert angles_between(own.unproject(pixels).directions, points).max() < 1e-12


@given(terms=st.tuples(small, small, small, small))
def test_ftheta_is_inverted_over_its_whole_domain(terms):
    assert round_trip_error(camera("ftheta", *terms), 1e-3) < 1e-9
    assert round_trip_error(camera("ftheta_inverse", *terms), 1e-3) < 1e-9


@given(a2=st.floats(-0.6, 0.1), a3=small, a4=small, shear=st.tuples(small, small))
def test_ocam_is_inverted_over_its_whole_domain(a2, a3, a4, shear):
    assert round_trip_error(camera("ocam", a2, a3, a4, *shear), 1e-3) < 1e-9


def test_the_radius_of_ptlens_is_a_polynomial_of_that_of_a_pinhole():
    tangent = np.linspace(0, 1.5, 30)
    points = np.column_stack([np.zeros(30), tangent, np.ones(30)])
    found = camera("ptlens", *TERMS[:3]).project(2 * points).pixels[:, 1]
    expected = tangent + 0.03 * tangent**2 - 0.05 * tangent**3 + 0.01 * tangent**4
    np.testing.assert_allclose(found, 505 * expected + 241.25, atol=1e-9)


@given(terms=st.tuples(small, small, small))
@pytest.mark.parametrize("name", ["ptlens", "ptlens_equisolid", "ptlens_stereographic"])
def test_ptlens_is_inverted_over_its_whole_domain(name, terms):
    assert round_trip_error(camera(name, *terms), 1e-3) < 1e-9


def test_the_radius_of_ptlens_for_fisheyes_is_a_polynomial_of_theirs():
    theta = np.radians(np.arange(0, 150, 5.0))
    for name, ideal in (("ptlens_equisolid", 2 * np.sin(theta / 2)), ("ptlens_stereographic", 2 * np.tan(theta / 2))):
        found = camera(name, *TERMS[:3]).project(2 * rays(theta, np.zeros_like(theta)))
        expected = ideal + 0.03 * ideal**2 - 0.05 * ideal**3 + 0.01 * ideal**4
        assert found.valid[theta < 1].all()
        np.testing.assert_allclose(found.pixels[found.valid, 0], (500 * expected + 319.5)[found.valid], atol=1e-9)


def test_they_end_where_they_fold():
    own = camera("ftheta", -0.25)  # dr/dθ = 1 - θ/2
    assert own.model.domain(own.parameters).max_theta == pytest.approx(2.0)
    own = camera("ftheta_inverse", -0.25)  # θ = 1 at r = 2
    assert own.model.domain(own.parameters).max_theta == pytest.approx(1.0)
    assert camera("ftheta_inverse").model.domain(camera("ftheta_inverse").parameters).max_theta == np.pi
    own = camera("ptlens", -0.25)  # dr/dt = 1 - t/2
    assert own.model.domain(own.parameters).max_theta == pytest.approx(np.arctan(2.0))
    own = camera("ocam", 0.25)  # the ray (r, 1 + r²/4) comes back from r = 2 on
    assert own.model.domain(own.parameters).max_theta == pytest.approx(np.pi / 4)


@pytest.mark.parametrize("angle", [0.0, *(10.0 ** -np.arange(1, 13))])
@pytest.mark.parametrize("name", ["ftheta", "ftheta_inverse", "ocam"])
def test_pixels_and_derivatives_are_exact_near_the_axis(name, angle):
    own = camera(name, *TERMS[:3])
    point = 2 * rays(np.array([angle]), np.array([0.7]))
    found = own.project_with_jacobians(point)
    radius = np.hypot(*((found.pixels[0] - CORE[2:]) / CORE[:2]))
    assert radius == pytest.approx(np.tan(angle), rel=0.1)
    # a quarter of a pixel of 500 px per radian turns the slope by at most a2 ~ 0.03
    np.testing.assert_allclose(found.d_point[0, :, :2], [[250, 0], [0, 252.5]], atol=60 * angle + 1e-6)


def test_ocam_is_understood_by_the_name_of_its_author():
    assert model_named("scaramuzza").name == "ocam"


OCAM = """#polynomial coefficients for the DIRECT mapping function (ocam_model.ss)

{0} -3.2e+02 0.0 8.6e-04 -3.5e-08 6.7e-09

#polynomial coefficients for the inverse mapping function (ocam_model.invpol)

2 407.2 159.6

#center: "row" and "column", starting from 0 (C convention)

261.75 326.5

#affine parameters "c", "d", "e"

1.002 0.0014 0.0001

#image size: "height" and "width"

480 640
"""
VINS = """%YAML:1.0
---
model_type: scaramuzza
camera_name: camera
image_width: 640
image_height: 480
poly_parameters:
   p0: -3.2e+02
   p1: 0.0
   p2: 8.6e-04
   p3: -3.5e-08
   p4: 6.7e-09
inv_poly_parameters:
   p0: 407.2
affine_parameters:
   ac: 1.002
   ad: 0.0014
   ae: 0.0001
   cx: 326.5
   cy: 261.75
"""
MATLAB = {
    "MappingCoefficients": [3.2e2, -8.6e-4, 3.5e-8, -6.7e-9],
    "DistortionCenter": [327.5, 262.75],
    "StretchMatrix": [[1.002, 0.0014], [0.0001, 1.0]],
    "ImageSize": [480, 640],
}


@pytest.mark.parametrize(
    ("name", "text", "on_rows"),
    [("calib_results.txt", OCAM.format(5), True), ("cam.yaml", VINS, False), ("m.json", json.dumps(MATLAB), False)],
)
def test_each_program_stretches_its_own_way(tmp_path, name, text, on_rows):
    path = tmp_path / name
    path.write_text(text)
    (entry,) = cameras.read(path, given=Given()).cameras.values()
    assert entry.camera.image_size == SIZE
    x, y = np.array([120.0, -200.0, 30.0]), np.array([90.0, 100.0, -150.0])
    depth = 3.2e2 - 8.6e-4 * (x * x + y * y) + 3.5e-8 * np.hypot(x, y) ** 3 - 6.7e-9 * (x * x + y * y) ** 2
    if on_rows:
        pixels = np.column_stack([x + 0.0001 * y, 0.0014 * x + 1.002 * y])
    else:
        pixels = np.column_stack([1.002 * x + 0.0014 * y, 0.0001 * x + y])
    found = entry.camera.project(np.column_stack([x, y, depth])).pixels
    np.testing.assert_allclose(found, pixels + np.array([326.5, 261.75]), atol=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (OCAM.format(6), "has 5 coefficients where it counts 6"),
        (OCAM.format(5).replace("480 640", ""), "each on its line of numbers"),
        (OCAM.format(5).replace("-3.2e+02 0.0", "-3.2e+02 0.1"), "without a linear term"),
        (OCAM.format(5).replace("-3.2e+02", "3.2e+02"), "calibrate with --model ocam"),
    ],
    ids=range(4),
)
def test_other_polynomials_are_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "calib_results.txt"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=said):
        cameras.read(path, given=Given())


def test_a_polynomial_of_degree_two_is_one_of_degree_four():
    stretch = np.eye(2)
    short = polynomial_camera(SIZE, np.array([-300.0, 0.0, 0.001]), stretch, (320.0, 240.0), "")
    long = polynomial_camera(SIZE, np.array([-300.0, 0.0, 0.001, 0.0, 0.0]), stretch, (320.0, 240.0), "")
    np.testing.assert_array_equal(short.parameters, long.parameters)
