"""Corners a detector proposes, verified against drawn boards."""

import numpy as np
from drawn import picture, pose, truth, upright

from camcal.targets.board import Board
from camcal.targets.checker import extended, settle

BOARD = Board("chessboard", 7, 5)
SIZE = (400, 300)
TILTED = pose([(81.3, 60.2), (317.1, 41.8), (300.9, 235.4), (95.2, 251.7)])
IMAGE = picture(BOARD, TILTED, SIZE)
GRID = truth(BOARD, TILTED).reshape(BOARD.rows, BOARD.columns, 2)


def worst(checker):
    return np.nanmax(np.linalg.norm(checker.grid - GRID, axis=-1))


def test_proposals_some_pixels_off_become_the_corners():
    checker = settle(IMAGE, GRID + np.random.default_rng(0).uniform(-5, 5, GRID.shape))
    assert checker.found.all()
    assert checker.sign == 1
    assert worst(checker) < 0.012  # as fit_corners: five rays a pixel


def test_a_corner_proposed_in_the_wrong_place_is_put_right():
    start = GRID.copy()
    start[0, 0] += 25
    start[3, 4] -= (18, 3)
    start[4, 6] = np.nan
    checker = settle(IMAGE, start)
    assert checker.found.all()
    assert worst(checker) < 0.012


def test_hidden_corners_are_left_out():
    hidden = IMAGE.copy()
    u, v = GRID[1, 2].astype(int)
    hidden[v - 25 : v + 25, u - 25 : u + 25] = 130
    checker = settle(hidden, GRID)
    assert not checker.found[1, 2]
    assert checker.found.sum() >= BOARD.count - 4
    assert worst(checker) < 0.05  # the patch cuts into windows beside it


def test_a_grid_in_the_wrong_place_finds_nothing_of_a_checker_pattern():
    assert settle(IMAGE, GRID + GRID[1, 1] / 2 - GRID[0, 0] / 2).found.sum() < BOARD.count / 2
    rng = np.random.default_rng(2)
    assert settle(rng.integers(0, 256, IMAGE.shape).astype(np.uint8), GRID).found.sum() == 0


def test_a_pattern_is_followed_to_its_end_on_every_side():
    checker = extended(IMAGE, settle(IMAGE, GRID[1:4, 2:5]))
    assert checker.grid.shape == GRID.shape
    assert checker.sign == 1
    assert worst(checker) < 0.5  # corners that are added are fitted with a part of the samples


def test_a_whole_board_is_not_extended_whatever_lies_behind_it():
    assert extended(IMAGE, settle(IMAGE, GRID)).grid.shape == GRID.shape
    board = Board("chessboard", 6, 4)
    homography = upright(board, SIZE, 0.7)
    grid = truth(board, homography).reshape(4, 6, 2)
    dark_wall = picture(board, homography, SIZE)
    top, step = grid[0, 0, 1], grid[0, 1, 0] - grid[0, 0, 0]
    dark_wall[: round(top - step)] = 30  # the sheet cut off along its first row of squares
    assert extended(dark_wall, settle(dark_wall, grid)).grid.shape == grid.shape
