"""The picture of two crossing edges, fitted to drawn ones.

What this does not prove: how real lenses and sensors blur; benchmarks/detection.py compares on real sets.
"""

from functools import cache

import numpy as np
import pytest
from drawn import picture, pose, truth, upright

from camcal.targets.board import Board
from camcal.targets.grid import steps
from camcal.targets.subpixel import fit_corners
from camcal.targets.windows import FINE, QUICK, WIDE

BOARD = Board("chessboard", 5, 4)
SIZE = (320, 240)
TILTED = pose([(81.3, 60.2), (247.1, 41.8), (230.9, 185.4), (95.2, 201.7)])


@cache
def image(blur=0.7, noise=0.0):
    return picture(BOARD, TILTED, SIZE, blur=blur, noise=noise)


def fitted(view, pixels, window=FINE, board=BOARD, clearance=np.inf):
    grid = truth(board, TILTED if board is BOARD else upright(board, SIZE)).reshape(board.rows, board.columns, 2)
    return fit_corners(view, pixels, steps(grid).reshape(-1, 2, 2), window, clearance)


def error(fits, board=BOARD, homography=TILTED):
    return np.linalg.norm(fits.pixels - truth(board, homography), axis=1)


@pytest.mark.parametrize("blur", [0.0, 0.7, 2.0])
def test_corners_of_a_clean_picture_are_found_to_a_hundredth_of_a_pixel(blur):
    start = truth(BOARD, TILTED) + np.random.default_rng(1).uniform(-1.5, 1.5, (BOARD.count, 2))
    # Six rays a pixel place an edge to 1/12 px, less where it runs across many pixels; a picture without any blur is
    # no image of a lens, and the samples of its edges are between two levels only.
    assert error(fitted(image(blur), start)).max() < (0.06 if blur == 0 else 0.02)


def test_noise_moves_corners_no_more_than_theory_says():
    """The bound for an edge of slope 190 / (0.99 √2π) a pixel under noise 5: 5 / (77 √24) = 0.013 px, both axes."""
    assert np.sqrt((error(fitted(image(noise=5), truth(BOARD, TILTED))) ** 2).mean()) < 0.035


def test_the_start_leaves_no_trace():
    first, second = (
        fitted(image(), truth(BOARD, TILTED) + np.random.default_rng(seed).uniform(-0.4, 0.4, (BOARD.count, 2)))
        for seed in (1, 2)
    )
    assert np.abs(first.pixels - second.pixels).max() < 0.01  # windows begin at other whole pixels


def test_a_wide_window_finds_a_corner_that_is_a_third_of_a_step_away():
    board = Board("chessboard", 4, 3)
    homography = upright(board, SIZE)
    step = np.diff(truth(board, homography)[:2, 0])[0]
    start = truth(board, homography) + step / 3 * np.array([0.6, -0.8])
    fits = fitted(picture(board, homography, SIZE), start, WIDE, board)
    assert error(fits, board, homography).max() < 2  # it samples every fifth pixel or so


def test_a_quick_fit_is_good_to_tenths_of_a_pixel():
    assert error(fitted(image(), truth(BOARD, TILTED) + 1.2, QUICK)).max() < 0.1


def test_contrast_tells_whether_the_square_before_both_steps_is_dark():
    fits = fitted(image(0.0), truth(BOARD, TILTED))
    row, column = np.divmod(np.arange(BOARD.count), BOARD.columns)
    # half of 220 - 30; the blur model takes a little of it at the finest edges
    np.testing.assert_allclose(fits.contrast, np.where((row + column) % 2, -95, 95), rtol=0.03)


def test_print_within_the_squares_does_not_move_a_corner():
    marked = image().copy()
    for (u, v), (next_u, next_v) in zip(truth(BOARD, TILTED)[:-6], truth(BOARD, TILTED)[6:], strict=True):
        x, y = int(0.7 * u + 0.3 * next_u), int(0.7 * v + 0.3 * next_v)
        marked[y - 2 : y + 3, x - 2 : x + 3] = 128  # within the window's radius, on one side of the corner
    start = truth(BOARD, TILTED)
    plain, printed = (fitted(each, start, clearance=0.15) for each in (image(), marked))
    assert np.abs(plain.pixels - printed.pixels).max() < 0.03


@pytest.mark.parametrize("what", ["outer corner", "edge", "noise", "nothing"])
def test_what_is_no_crossing_does_not_agree(what):
    y, x = np.mgrid[0:60, 0:60]
    rng = np.random.default_rng(3)
    view = {
        "outer corner": np.where((x < 30) & (y < 30), 30, 220),
        "edge": np.where(x < 30, 30, 220),
        "noise": rng.integers(0, 256, (60, 60)),
        "nothing": np.full((60, 60), 100),
    }[what].astype(np.uint8)
    fits = fit_corners(view, np.array([[29.5, 29.5]]), 30 * np.eye(2)[None])
    assert fits.agreement[0] < 0.7


def test_a_crossing_agrees():
    fits = fitted(image(noise=5), truth(BOARD, TILTED))
    assert fits.agreement.min() > 0.97


def test_a_corner_at_the_rim_of_the_image_is_fitted_from_what_is_inside():
    u, v = truth(BOARD, TILTED)[0]
    cut = image()[int(v) - 3 :, int(u) - 3 :]
    start = np.array([[u - int(u) + 3.0, v - int(v) + 3.0]])
    grid = truth(BOARD, TILTED).reshape(BOARD.rows, BOARD.columns, 2)
    fits = fit_corners(cut, start, steps(grid)[:1, 0])
    assert np.linalg.norm(fits.pixels - start) < 0.02


def test_parallel_steps_give_a_fit_that_does_not_agree_and_no_error():
    fits = fit_corners(image(), np.array([[20.0, 20.0]]), np.array([[[5.0, 5.0], [5.0, 5.0]]]))
    assert fits.agreement[0] < 0.75
