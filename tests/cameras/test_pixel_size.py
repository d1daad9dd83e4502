"""The size of a pixel through rays: against the closed forms of a pinhole, and against the projection of a ruler."""

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS, model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import field_of_view, field_size, pixel_angles, pixel_sizes

SIZE = (640, 480)
PIXELS = np.array([[319.5, 239.5], [0.0, 0.0], [639.0, 100.0]])


def pinhole(cx=319.5, size=SIZE, focal=500.0):
    return Camera(model_named("pinhole"), size, np.array([focal, focal, cx, (size[1] - 1) / 2]))


def distorted(name):
    model = MODELS[name]
    parameters = model.start(SIZE, 500.0)
    parameters[4:6] = -0.1, 0.02  # k1, k2
    return Camera(model, SIZE, parameters)


def test_a_pixel_of_a_pinhole_sees_less_of_an_angle_towards_the_corner():
    cosines = 500 / np.sqrt(500**2 + np.sum((PIXELS - [319.5, 239.5]) ** 2, axis=1))
    expected = np.sqrt(cosines**3) / 500  # the solid angle of a flat pixel falls with the cube of the cosine
    assert pixel_angles(pinhole(), PIXELS) == pytest.approx(expected, rel=1e-6)  # differences over half a pixel


def test_a_pinhole_shows_a_plane_evenly():
    assert pixel_sizes(pinhole(cx=280.0), PIXELS, 2.0) == pytest.approx([2 / 500] * 3)
    assert field_size(pinhole(cx=280.0), 2.0) == pytest.approx((2 * 640 / 500, 2 * 480 / 500))


@pytest.mark.parametrize("name", ["opencv5", "kannala_brandt4"])
def test_a_square_on_the_plane_has_as_many_pixels_as_their_size_says(name):
    camera, distance, side = distorted(name), 1.5, 1e-3
    for pixel, size in zip(PIXELS, pixel_sizes(camera, PIXELS, distance), strict=True):
        ray = camera.unproject(pixel[None]).directions[0]
        corners = distance * ray / ray[2] + side / 2 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        x, y = camera.project(corners).pixels.T
        area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
        assert side / np.sqrt(area) == pytest.approx(size, rel=1e-4)  # the lens bends over the square


def test_the_field_of_view_of_an_off_centre_camera_is_not_twice_that_of_a_half():
    # the reference counts 600 px from the outer edge of the image, half a pixel before the first centre
    horizontal, _, _ = np.degrees(field_of_view(pinhole(cx=599.5, size=(1280, 960), focal=800.0)))
    assert horizontal == pytest.approx(77.234, abs=5e-4)
    assert np.degrees(2 * np.arctan(1280 / 1600)) == pytest.approx(77.320, abs=5e-4)


def test_what_looks_backwards_has_no_size_on_a_plane():
    model = MODELS["kannala_brandt4"]
    wide = Camera(model, SIZE, model.start(SIZE, 150.0))
    sizes = pixel_sizes(wide, PIXELS, 1.0)
    assert np.isfinite(sizes[0])
    assert np.isnan(sizes[1])
    assert np.isnan(field_size(wide, 1.0)[0])
    assert np.isfinite(pixel_angles(wide, PIXELS)).all()
