"""A camera for resized images sees the same points in the same places of the picture, and is as uncertain."""

import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera, resized
from camcal.errors import InvalidInput


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_pixels_of_the_resized_image_are_those_of_the_old_one_scaled(model):
    parameters = model.start((640, 480), 500.0)
    parameters[2:4] += 7.0, -3.0
    camera = Camera(model, (640, 480), parameters)
    points = np.random.default_rng(1).uniform((-0.3, -0.2, 1), (0.3, 0.2, 2), (20, 3))
    small = resized(camera, (320, 240))
    expected = (camera.project(points).pixels + 0.5) / 2 - 0.5  # edges stay edges: pixel centres move
    np.testing.assert_allclose(small.project(points).pixels, expected, atol=1e-9)


def test_the_covariance_is_that_of_the_scaled_parameters():
    rng = np.random.default_rng(2)
    model = MODELS["opencv5"]
    root = rng.normal(0, 1e-2, (9, 9))
    camera = Camera(model, (640, 480), [500, 510, 320, 240, -0.2, 0.1, 0, 0, 0], root @ root.T, fixed=())
    twice = resized(camera, (1280, 960))
    scale = np.diag([2.0, 2, 2, 2, 1, 1, 1, 1, 1])
    np.testing.assert_allclose(twice.covariance, scale @ camera.covariance @ scale, rtol=1e-9)
    back = resized(twice, (640, 480))
    np.testing.assert_allclose(back.parameters, camera.parameters, rtol=1e-12)


def test_the_same_size_is_the_same_camera_and_another_shape_is_refused():
    camera = Camera(MODELS["pinhole"], (640, 480), [500.0, 500.0, 320.0, 240.0])
    assert resized(camera, (640, 480)) is camera
    assert resized(camera, (1067, 800)).image_size == (1067, 800)  # rounding of 1066.67
    with pytest.raises(InvalidInput, match="images of 640 x 360 pixels are not resized images of 640 x 480"):
        resized(camera, (640, 360))


def test_sides_may_be_rounded_to_whole_pixels_and_no_further():
    camera = Camera(MODELS["pinhole"], (1600, 1200), [1500.0, 1500.0, 800.0, 600.0])
    assert resized(camera, (801, 600)).image_size == (801, 600)
    with pytest.raises(InvalidInput, match="802 x 600 pixels are not resized images"):
        resized(camera, (802, 600))
