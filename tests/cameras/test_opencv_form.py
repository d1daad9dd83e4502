"""Cameras to and from OpenCV's camera matrix and distortion coefficients, judged by OpenCV's own projection."""

import cv2
import numpy as np
import pytest

from camcal.cameras.catalogue import MODELS
from camcal.cameras.model import Camera
from camcal.errors import InvalidInput

K = np.array([[700.0, 0, 321], [0, 710, 243], [0, 0, 1]])
SIZE = (640, 480)
POINTS = np.random.default_rng(1).uniform((-0.4, -0.3, 1), (0.4, 0.3, 2), (30, 3))


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_a_camera_from_opencv_projects_as_opencv_does(count):
    dist = np.random.default_rng(count).uniform(-0.02, 0.02, count)
    camera = Camera.from_opencv(K, dist, SIZE)
    expected = cv2.projectPoints(POINTS, np.zeros(3), np.zeros(3), K, dist)[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(POINTS).pixels, expected, atol=1e-9)
    np.testing.assert_array_equal(camera.K, K)
    np.testing.assert_array_equal(camera.dist, dist)


def test_a_fisheye_from_opencv_projects_as_opencv_does():
    dist = np.array([[-0.02], [0.003], [0.001], [-0.0004]])  # a column, as OpenCV returns them
    camera = Camera.from_opencv(K.tolist(), dist, SIZE, fisheye=True)
    expected = cv2.fisheye.projectPoints(POINTS[None], np.zeros(3), np.zeros(3), K, dist)[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(POINTS).pixels, expected, atol=1e-9)
    np.testing.assert_array_equal(camera.dist, dist.ravel())


def test_no_coefficients_are_a_pinhole():
    assert Camera.from_opencv(K, None, SIZE).model.name == "pinhole"


def test_the_matrix_and_the_coefficients_are_copies():
    camera = Camera.from_opencv(K, np.zeros(5), SIZE)
    camera.K[0, 0] = camera.dist[0] = 1.0
    assert camera.value("fx") == 700.0
    assert camera.value("k1") == 0.0


@pytest.mark.parametrize(
    ("matrix", "dist", "fisheye", "message"),
    [
        (K, np.zeros(6), False, "cv2 takes 0, 4, 5, 8, 12, 14 distortion coefficients, found 6"),
        (K, np.zeros(5), True, "cv2.fisheye takes 4 distortion coefficients, found 5"),
        (K + np.eye(3)[[1, 2, 0]] * 0.5, np.zeros(5), False, "skew"),
        (np.diag([-700.0, 700, 1]), np.zeros(5), False, "positive focal lengths"),
        (np.diag([np.nan, 700, 1]), np.zeros(5), False, "positive focal lengths"),
        (np.eye(2), None, False, r"the camera matrix has shape \(2, 2\), expected \(3, 3\)"),
    ],
)
def test_what_opencv_would_not_take_is_refused(matrix, dist, fisheye, message):
    with pytest.raises(InvalidInput, match=message):
        Camera.from_opencv(matrix, dist, SIZE, fisheye=fisheye)


@pytest.mark.parametrize("name", [name for name, model in MODELS.items() if not model.opencv])
def test_a_model_that_opencv_lacks_has_no_coefficients_for_it(name):
    camera = Camera(MODELS[name], SIZE, MODELS[name].start(SIZE, 500.0))
    with pytest.raises(InvalidInput, match=name):
        _ = camera.dist
