"""Quick looks at corners of drawn boards."""

import numpy as np
import pytest
from drawn import picture, pose, truth

from camcal.targets.board import Board
from camcal.targets.checker import proposals as grids
from camcal.targets.checker.checker import measure_saddles, measure_saddles_at

BOARD = Board("chessboard", 7, 5)
SIZE = (400, 300)
TILTED = pose([(81.3, 60.2), (317.1, 41.8), (300.9, 235.4), (95.2, 251.7)])
GRID = truth(BOARD, TILTED).reshape(BOARD.rows, BOARD.columns, 2)
PIXELS, STEPS = GRID.reshape(-1, 2), grids.steps(GRID).reshape(-1, 2, 2)
CLOSE = 0.15  # px: samples lie a pixel or two apart


@pytest.mark.parametrize("blur", [0.5, pytest.param(1.5, marks=pytest.mark.slow), 4.0])
def test_corners_a_few_pixels_away_are_found_whatever_the_blur(blur):
    image = picture(BOARD, TILTED, SIZE, blur=blur, noise=2.0)
    start = PIXELS + np.random.default_rng(0).uniform(-3, 3, PIXELS.shape)
    pixels, _, agreement = measure_saddles(image, start, STEPS, 0.15)
    assert np.linalg.norm(pixels - PIXELS, axis=1).max() < CLOSE
    assert agreement.min() > 0.9


def test_from_afar_corners_are_found_a_third_of_a_step_away():
    image = picture(BOARD, TILTED, SIZE)
    start = PIXELS + 0.3 * STEPS[..., 0] - 0.2 * STEPS[..., 1]
    assert np.linalg.norm(measure_saddles(image, start, STEPS, far=True)[0] - PIXELS, axis=1).max() < CLOSE


def test_contrast_is_about_half_of_bright_minus_dark_and_positive_after_a_dark_square():
    image = picture(BOARD, TILTED, SIZE, blur=0.3)
    _, contrast, _ = measure_saddles_at(image, PIXELS, STEPS, 0.15)
    row, column = np.divmod(np.arange(BOARD.count), BOARD.columns)
    np.testing.assert_allclose(contrast, np.where((row + column) % 2, -95, 95), rtol=0.2)  # a picture


def test_an_edge_and_the_outer_corner_of_a_square_do_not_look_like_corners():
    image = picture(BOARD, TILTED, SIZE)
    _, _, agreement = measure_saddles_at(image, PIXELS + STEPS[..., 0] / 2, STEPS, 0.15)
    assert agreement.max() < 0.2
    wide = grids.predict(grids.widen(GRID))
    rim = np.concatenate([wide[0, 1:-1], wide[-1, 1:-1]])
    steps = np.concatenate([grids.steps(wide)[0, 1:-1], grids.steps(wide)[-1, 1:-1]])
    assert measure_saddles_at(image, rim, steps, 0.15)[2].max() < 0.75  # as checker.AGREEMENT asks


def test_places_outside_the_image_show_nothing():
    image = picture(BOARD, TILTED, SIZE)
    assert measure_saddles_at(image, PIXELS - SIZE, STEPS)[2].max() == 0
