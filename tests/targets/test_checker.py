"""Corners a detector proposes, verified against drawn boards."""

import numpy as np
import pytest
from drawn import picture, pose, truth, upright

from camcal.targets.board import Board
from camcal.targets.checker.checker import clear_corners, extended, trimmed, verified_corners

BOARD = Board("chessboard", 7, 5)
SIZE = (400, 300)
SETTLED = 0.1  # px: samples lie a pixel or two apart
TILTED = pose([(81.3, 60.2), (317.1, 41.8), (300.9, 235.4), (95.2, 251.7)])
IMAGE = picture(BOARD, TILTED, SIZE)
GRID = truth(BOARD, TILTED).reshape(BOARD.rows, BOARD.columns, 2)


def worst(grid):
    return np.nanmax(np.linalg.norm(grid - GRID, axis=-1))


def test_proposals_some_pixels_off_become_the_corners():
    checker = verified_corners(IMAGE, GRID + np.random.default_rng(0).uniform(-5, 5, GRID.shape))
    assert checker.found.all()
    assert checker.sign == 1
    assert worst(checker.grid) < SETTLED


def test_a_corner_proposed_in_the_wrong_place_is_put_right():
    start = GRID.copy()
    start[0, 0] += 25
    start[3, 4] -= (18, 3)
    start[4, 6] = np.nan
    checker = verified_corners(IMAGE, start)
    assert checker.found.all()
    assert worst(checker.grid) < SETTLED


def test_the_contrast_is_half_of_bright_minus_dark():
    # (220 - 30) / 2; the picture of the look has a blur of its own
    assert verified_corners(IMAGE, GRID).contrast == pytest.approx(95, rel=0.2)


def test_hidden_corners_are_left_out():
    hidden = IMAGE.copy()
    u, v = GRID[1, 2].astype(int)
    hidden[v - 25 : v + 25, u - 25 : u + 25] = 130
    checker = verified_corners(hidden, GRID)
    assert not checker.found[1, 2]
    assert checker.found.sum() >= BOARD.count - 4
    assert worst(clear_corners(hidden, checker)) < SETTLED


def test_a_corner_that_a_finger_touches_is_left_out():
    touched = IMAGE.copy()
    u, v = GRID[2, 3].astype(int)
    touched[v + 1 : v + 30, u + 1 : u + 30] = 20
    grid = clear_corners(touched, verified_corners(touched, GRID))
    assert np.isnan(grid[2, 3]).all()
    assert worst(grid) < SETTLED
    np.testing.assert_array_equal(np.isnan(clear_corners(IMAGE, verified_corners(IMAGE, GRID))), False)


def test_a_grid_in_the_wrong_place_finds_nothing_of_a_checker_pattern():
    assert verified_corners(IMAGE, GRID + GRID[1, 1] / 2 - GRID[0, 0] / 2).found.sum() < BOARD.count / 2
    rng = np.random.default_rng(2)
    assert verified_corners(rng.integers(0, 256, IMAGE.shape).astype(np.uint8), GRID).found.sum() == 0


def test_a_pattern_is_followed_to_its_end_on_every_side():
    checker = extended(IMAGE, verified_corners(IMAGE, GRID[1:4, 2:5]))
    assert checker.grid.shape == GRID.shape
    assert checker.sign == 1
    assert worst(checker.grid) < SETTLED


def test_outer_rows_that_are_not_seen_are_cut_off():
    start = np.pad(GRID, ((1, 0), (2, 0), (0, 0)), mode="reflect", reflect_type="odd")
    checker = verified_corners(IMAGE, start)
    assert checker.grid.shape == (6, 9, 2)
    cut = trimmed(checker)
    np.testing.assert_allclose(cut.grid, GRID, atol=SETTLED)
    assert cut.sign == 1


def test_a_whole_board_is_not_extended_whatever_lies_behind_it():
    assert extended(IMAGE, verified_corners(IMAGE, GRID)).grid.shape == GRID.shape
    board = Board("chessboard", 6, 4)
    homography = upright(board, SIZE, 0.7)
    grid = truth(board, homography).reshape(4, 6, 2)
    dark_wall = picture(board, homography, SIZE)
    top, step = grid[0, 0, 1], grid[0, 1, 0] - grid[0, 0, 0]
    dark_wall[: round(top - step)] = 30  # the sheet cut off along its first row of squares
    assert extended(dark_wall, verified_corners(dark_wall, grid)).grid.shape == grid.shape
