"""Fisheyes of other programs: polynomials with tangential and prism terms before or after them, and a tilted sensor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sphere_models import CORE, SIZE, rays, round_trip_error

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.cameras.refit import same_lens
from camcal.formats import cameras
from camcal.formats.cameras.record import Given

RADIAL = (0.02, -0.01, 0.002, -0.0005, 0.0002, -0.00003)
TANGENTIAL, PRISM = (0.0011, -0.0007), (0.0008, -0.0003, -0.0005, 0.0002)
small = st.floats(-0.002, 0.002)


def camera(name, *values):
    model = MODELS[name]
    return Camera(model, SIZE, np.array([*CORE, *values, *(0.0,) * (len(model.parameter_names) - 4 - len(values))]))


def by_hand(theta, azimuth, radial, tangential, prism, *, late):
    """Terms in the order of OpenCV, of the angle or of the radius."""
    radius = theta * (1 + sum(k * theta ** (2 * power) for power, k in enumerate(radial, 1)))
    direction = np.stack([np.cos(azimuth), np.sin(azimuth)])
    x, y = direction * (radius if late else theta)
    square = x * x + y * y
    p1, p2 = tangential
    s0, s1, s2, s3 = prism
    moved = direction * radius + np.stack(
        [
            2 * p1 * x * y + p2 * (square + 2 * x * x) + s0 * square + s1 * square**2,
            2 * p2 * x * y + p1 * (square + 2 * y * y) + s2 * square + s3 * square**2,
        ]
    )
    return (moved * [[500], [505]] + [[319.5], [241.25]]).T


@pytest.mark.parametrize(
    ("name", "values", "prism", "late"),
    [
        ("fisheye62", (*RADIAL, *TANGENTIAL), (0, 0, 0, 0), False),
        ("opensfm_fisheye624", (*RADIAL, *TANGENTIAL, *PRISM), PRISM, False),
        ("fisheye624", (*RADIAL, *TANGENTIAL[::-1], *PRISM), PRISM, True),
    ],
)
def test_terms_stand_where_the_program_has_them(name, values, prism, late):
    rng = np.random.default_rng(5)
    theta, azimuth = rng.uniform(0, 1.6, 200), rng.uniform(0, 2 * np.pi, 200)
    found = camera(name, *values).project(2 * rays(theta, azimuth))
    expected = by_hand(theta, azimuth, RADIAL, TANGENTIAL, prism, late=late)
    assert found.valid.all()
    np.testing.assert_allclose(found.pixels, expected, atol=1e-9)


def test_colmaps_prism_has_one_term_an_axis():
    own = camera("thin_prism_fisheye", *RADIAL[:2], *TANGENTIAL, *RADIAL[2:4], 0.0008, -0.0005)
    theta, azimuth = np.linspace(0, 1.5, 50), np.linspace(0, 6, 50)
    expected = by_hand(theta, azimuth, RADIAL[:4], TANGENTIAL, (0.0008, 0, -0.0005, 0), late=False)
    np.testing.assert_allclose(own.project(rays(theta, azimuth)).pixels, expected, atol=1e-9)


@given(k1=st.floats(-0.05, 0.05), p=st.tuples(small, small), s=st.tuples(small, small, small, small))
def test_they_are_inverted_over_their_whole_domain(k1, p, s):
    assert round_trip_error(camera("fisheye624", k1, 0, 0, 0, 0, 0, *p, *s), 1e-3) < 1e-9
    assert round_trip_error(camera("opensfm_fisheye624", k1, 0, 0, 0, 0, 0, *p, *s), 1e-3) < 1e-9
    assert round_trip_error(camera("thin_prism_fisheye", k1, 0, *p, 0, 0, *s[:2]), 1e-3) < 1e-9


def test_late_prism_terms_end_the_domain_where_they_could_fold():
    own = camera("fisheye624", 0, 0, 0, 0, 0, 0, 0.05, 0, 0, 0, 0.1, 0)
    # 6 |p| r + 2 |s| r = 1
    assert own.model.domain(own.parameters).max_theta == pytest.approx(2.0)
    own = camera("fisheye624", 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.03125, 0, 0)
    assert own.model.domain(own.parameters).max_theta == pytest.approx(2.0)  # 4 |s| r³ = 1


def test_a_fisheye_on_a_tilted_sensor_is_seen_through_the_tilt_of_opencv():
    plain, tilted = camera("kannala_brandt4", *RADIAL[:4]), camera("kannala_brandt4_tilted", *RADIAL[:4], 0.1, -0.05)
    of_plane = camera("opencv14", *(0.0,) * 12, 0.1, -0.05)
    points = rays(np.linspace(0, 1.2, 40), np.linspace(0, 6, 40))
    places = (plain.project(points).pixels - CORE[2:]) / CORE[:2]
    expected = of_plane.project(np.column_stack([places, np.ones(40)])).pixels
    np.testing.assert_allclose(tilted.project(points).pixels, expected, atol=1e-9)
    back = tilted.unproject(tilted.project(points).pixels)
    np.testing.assert_allclose(back.directions, points, atol=1e-12)


@pytest.mark.parametrize(
    ("own", "expected"),
    [
        (("kannala_brandt4", 0.01, 0.002), 6),
        (("fisheye62", *RADIAL), 2),
        (("fisheye62", *RADIAL[:5]), 4),
        (("kannala_brandt5t", *RADIAL[:5], *TANGENTIAL), 2),
        (("fisheye624", *RADIAL[:4], 0, 0, *TANGENTIAL), 2),
        (("fisheye624", *RADIAL[:4]), 6),
        (("fisheye624", *RADIAL), 1),
        (("thin_prism_fisheye", *RADIAL[:2], 0, 0, *RADIAL[2:4]), 6),
        (("thin_prism_fisheye", *RADIAL[:2], 0.001), 1),
        (("opensfm_fisheye624", *RADIAL, *TANGENTIAL), 2),
    ],
    ids=str,
)
def test_the_same_fisheye_in_other_models_has_the_same_pixels(own, expected):
    first = camera(*own)
    found = same_lens(first)
    points = rays(np.linspace(0, 1.2, 40), np.linspace(0, 6, 40))
    assert len(found) == expected
    for each in found:
        np.testing.assert_allclose(each.project(points).pixels, first.project(points).pixels, rtol=1e-12)


def test_colmaps_panorama_is_the_equirectangular_view(tmp_path):
    path = tmp_path / "cameras.txt"
    path.write_text("1 EQUIRECTANGULAR 752 376 752 376\n")
    (entry,) = cameras.read(path, given=Given()).cameras.values()
    points = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [0.3, 0.2, -1]])
    # of pycolmap 4.2.1, which counts from the corner
    expected = [[376, 188], [470, 188], [376, 282], [717.11713427, 210.6529557]]
    np.testing.assert_allclose(entry.camera.project(points).pixels + 0.5, expected, atol=1e-8)
