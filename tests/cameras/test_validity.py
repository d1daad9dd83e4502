"""Folds inside the image, field of view, and the valid region of a camera file."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, field_and_fold, field_of_view, folds_inside, valid_block

IMAGE_SIZE = (641, 481)
CORNER = np.hypot(320, 240)


def camera(name, focal=500.0, **changes):
    model = model_named(name)
    parameters = model.start(IMAGE_SIZE, focal)
    for parameter, value in changes.items():
        parameters[model.parameter_names.index(parameter)] = value
    return Camera(model, IMAGE_SIZE, parameters)


def test_mild_distortion_does_not_fold():
    fold = folds_inside(camera("opencv5", k1=-0.2, k2=0.05))
    assert not fold.folds
    assert fold.radius_px == np.inf
    assert fold.corner_px == pytest.approx(CORNER)


def test_fold_is_found_at_the_radius_where_the_distortion_turns():
    fold = folds_inside(camera("opencv4", k1=-0.5))
    turn = np.sqrt(1 / 1.5)  # d(r - 0.5 r³)/dr = 0
    assert fold.folds
    assert fold.radius_px == pytest.approx(500 * (turn - 0.5 * turn**3), abs=0.01)  # bisection to a millionth
    assert fold.corner_px == pytest.approx(CORNER)


def test_fold_outside_the_image_is_no_fold():
    assert not folds_inside(camera("opencv4", focal=2000.0, k1=-0.5)).folds


def test_a_principal_point_off_the_centre_brings_the_far_corner_past_the_fold():
    assert not folds_inside(camera("opencv4", k1=-0.2)).folds
    fold = folds_inside(camera("opencv4", k1=-0.2, cx=100.0))
    assert fold.folds
    assert fold.corner_px == pytest.approx(np.hypot(540, 240))


def test_fisheye_folds_as_well():
    turn = np.sqrt(1 / 1.2)
    fold = folds_inside(camera("kannala_brandt4", k1=-0.4))
    assert fold.folds
    assert fold.radius_px == pytest.approx(500 * (turn - 0.4 * turn**3), abs=0.01)


def test_valid_block_reaches_to_the_corner_of_a_sound_camera():
    block = valid_block(camera("pinhole"))
    assert block["max_radius_px"] == pytest.approx(CORNER)
    assert block["max_theta_deg"] == pytest.approx(np.degrees(np.arctan(CORNER / 500)))


def test_valid_block_ends_at_the_fold():
    folding = camera("opencv4", k1=-0.5)
    block = valid_block(folding)
    assert block["max_radius_px"] == pytest.approx(folds_inside(folding).radius_px)
    # the angle at a fold is as good as the root of the bisection's step, 1e-3
    assert block["max_theta_deg"] == pytest.approx(np.degrees(np.arctan(np.sqrt(1 / 1.5))), abs=0.1)


def test_field_of_view_of_a_pinhole_is_that_of_its_outer_edges():
    horizontal, vertical, diagonal = field_of_view(camera("pinhole"))
    assert horizontal == pytest.approx(2 * np.arctan(641 / 1000))
    assert vertical == pytest.approx(2 * np.arctan(481 / 1000))
    assert diagonal == pytest.approx(2 * np.arctan(np.hypot(641, 481) / 1000))


def test_field_of_view_of_a_pinhole_off_centre_is_the_sum_of_its_sides():
    horizontal, _, _ = field_of_view(camera("pinhole", cx=100.0))
    assert horizontal == pytest.approx(np.arctan(100.5 / 500) + np.arctan(540.5 / 500))


def test_field_of_view_of_a_fisheye_passes_the_half_circle():
    horizontal, vertical, diagonal = field_of_view(camera("kannala_brandt4", focal=150.0))
    assert horizontal == pytest.approx(641 / 150)
    assert vertical == pytest.approx(481 / 150)
    assert diagonal == pytest.approx(np.hypot(641, 481) / 150)


def test_field_of_view_is_nan_where_an_edge_has_no_ray():
    horizontal, vertical, diagonal = field_of_view(camera("opencv4", k1=-0.5))
    assert np.isnan([horizontal, diagonal]).all()
    assert 0 < vertical < np.pi


@pytest.mark.parametrize("model", [("opencv4", -0.5), ("opencv5", -0.2), ("kannala_brandt4", -0.3)])
@pytest.mark.parametrize("lit", [None, 200.0])
def test_the_field_and_the_fold_of_one_unprojection_are_those_of_two(model, lit):
    own = camera(model[0], k1=model[1])
    circle = None if lit is None else ImageCircle(own.image_size, (own.value("cx"), own.value("cy")), lit)
    field, fold = field_and_fold(own, circle)
    np.testing.assert_allclose(field, field_of_view(own, circle)[0], rtol=1e-12)  # all pixels take as many steps
    assert fold == folds_inside(own, circle)
