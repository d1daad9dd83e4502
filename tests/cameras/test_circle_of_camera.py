"""The image circle of a camera, and what it changes of where a lens is valid."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, field_of_view, folds_inside, rim, valid_block

SIZE = (641, 481)
MIDDLE = np.array([320.0, 240.0])
CIRCLE = ImageCircle(SIZE, (330.0, 236.0), 200.0)


def camera(name, focal=150.0, **changes):
    model = model_named(name)
    parameters = model.start(SIZE, focal)
    for parameter, value in changes.items():
        parameters[model.parameter_names.index(parameter)] = value
    return Camera(model, SIZE, parameters)


def test_it_contains_what_is_no_farther_from_its_centre_than_its_radius():
    pixels = np.array([[[330.0, 236.0], [530.0, 236.0]], [[530.1, 236.0], [np.nan, 236.0]]])
    np.testing.assert_array_equal(CIRCLE.contains(pixels), [[True, True], [False, False]])


def test_ends_of_lines_outside_of_it_are_moved_along_their_lines_to_it():
    ends = np.array([[0.0, 0.0], [640.0, 100.0], [320.0, 480.0], [340.0, 250.0]])
    moved = CIRCLE.clipped(MIDDLE, ends)
    np.testing.assert_allclose(np.hypot(*(moved[:3] - CIRCLE.centre).T), 200.0, rtol=1e-12)
    lines, shorter = ends[:3] - MIDDLE, moved[:3] - MIDDLE
    np.testing.assert_allclose(lines[:, 0] * shorter[:, 1], lines[:, 1] * shorter[:, 0], rtol=1e-9, atol=1e-9)
    assert ((lines * shorter).sum(axis=1) > 0).all()
    np.testing.assert_array_equal(moved[3], ends[3])


def test_lines_that_start_outside_of_it_stay_as_they_are():
    ends = np.array([[0.0, 0.0], [330.0, 236.0]])
    np.testing.assert_array_equal(CIRCLE.clipped(np.array([10.0, 10.0]), ends), ends)


def test_a_resized_image_has_the_circle_resized_about_the_corner_of_its_first_pixel():
    half = ImageCircle((640, 480), (319.5, 239.5), 200.0).resized((320, 240))
    assert half == ImageCircle((320, 240), (159.5, 119.5), 100.0)


def test_the_rim_of_a_lens_is_its_image_circle_where_that_ends_before_the_image():
    border, fold = rim(camera("kannala_brandt4"), circle=CIRCLE)
    apart = np.hypot(*(border - CIRCLE.centre).T)
    assert apart.max() == pytest.approx(200.0)
    assert apart.min() == pytest.approx(200.0)  # here all of it lies inside the image
    assert fold.corner_px == pytest.approx(200.0 + np.hypot(10, 4), abs=0.1)  # 64 directions


def test_a_fold_outside_of_the_image_circle_is_none():
    folding = camera("kannala_brandt4", k1=-0.06)
    fold = folds_inside(folding)
    assert fold.folds
    assert CIRCLE.radius + np.hypot(10, 4) < fold.radius_px
    assert not folds_inside(folding, CIRCLE).folds


def test_valid_limits_and_field_of_view_end_at_the_image_circle():
    block = valid_block(camera("kannala_brandt4"), ImageCircle(SIZE, (320.0, 240.0), 200.0))
    assert block["max_radius_px"] == pytest.approx(200.0)
    assert block["max_theta_deg"] == pytest.approx(np.degrees(200 / 150))  # an equidistant lens
    angles = field_of_view(camera("kannala_brandt4"), ImageCircle(SIZE, (320.0, 240.0), 200.0))
    np.testing.assert_allclose(angles, 400 / 150)
    wide = field_of_view(camera("kannala_brandt4"), ImageCircle(SIZE, (320.0, 240.0), 300.0))
    np.testing.assert_allclose(wide, [600 / 150, 481 / 150, 600 / 150])  # the top and the bottom end with the image
