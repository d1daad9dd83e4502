"""Saddles of an image, and the checker patterns among them."""

import numpy as np
import pytest
from drawn import picture, pose, truth

from camcal.targets.board import Board, parse_board
from camcal.targets.checker.proposals import find_saddles, patterns

BOARD = Board("chessboard", 7, 5)
CHARUCO = parse_board("charuco:8x6:40mm:30mm:DICT_4X4_50:current")
SIZE = (400, 300)
TILTED = pose([(81.3, 60.2), (317.1, 41.8), (300.9, 235.4), (95.2, 251.7)])
STEEP = pose([(60.0, 110.0), (340.0, 140.0), (320.0, 180.0), (80.0, 200.0)])  # a third as high as it is wide
CLOSE = 0.3  # px; saddles of a blurred image, of neighbouring edges too


def ids_of(grid, board, homography):
    """The id of each corner of a pattern, (rows, columns), and how far it is from there."""
    pixels = truth(board, homography)
    away = np.linalg.norm(grid[:, :, None] - pixels, axis=-1)
    return np.where(np.isnan(grid[..., 0]), -1, np.nan_to_num(away, nan=np.inf).argmin(axis=-1)), away.min(axis=-1)


def is_block(ids, board):
    """Whether neighbours in a pattern are neighbours on the board."""
    row, column = np.divmod(ids, board.columns)
    for one, two in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = (ids[one] >= 0) & (ids[two] >= 0)
        apart = np.abs(row[one] - row[two]) + np.abs(column[one] - column[two])
        if (apart[both] != 1).any():
            return False
    return True


def test_the_corners_of_a_board_are_saddles_with_dark_on_the_sides_where_squares_are_dark():
    saddles = find_saddles(picture(BOARD, TILTED, SIZE))
    pixels = truth(BOARD, TILTED)
    away = np.linalg.norm(pixels[:, None] - saddles.pixels, axis=2)
    assert away.min(axis=1).max() < CLOSE
    grid = pixels.reshape(BOARD.rows, BOARD.columns, 2)
    before = grid[0, 0] - grid[1, 1]  # the square before corner 0 is dark
    dark = saddles.dark[away[0].argmin()]
    assert abs(np.cos(dark - np.arctan2(before[1], before[0]))) > np.cos(np.radians(15))


def test_an_edge_an_outer_corner_and_an_empty_wall_are_no_saddles():
    wall = np.full((80, 80), 100, np.uint8)
    assert len(find_saddles(wall).pixels) == 0
    wall[30:, 40:] = 200
    assert len(find_saddles(wall).pixels) == 0


@pytest.mark.parametrize("homography", [TILTED, STEEP], ids=["tilted", "steep"])
@pytest.mark.parametrize("blur", [0.7, 1.4])
def test_a_board_is_one_pattern_of_its_size_whose_rows_turn_clockwise_to_its_columns(homography, blur):
    found = patterns(find_saddles(picture(BOARD, homography, SIZE, blur=blur, noise=3.0)))
    grid = found[0]
    ids, away = ids_of(grid, BOARD, homography)
    assert sorted(grid.shape[:2]) == [5, 7]
    assert set(ids.ravel()) >= set(range(BOARD.count)) - {0, 6, 28, 34}  # a corner of a board may look unlike one
    assert np.nanmax(away) < 3 * CLOSE
    assert is_block(ids, BOARD)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    assert along[0] * down[1] - along[1] * down[0] > 0


def test_what_is_printed_in_the_squares_does_not_tie_corners_to_the_wrong_neighbours():
    found = patterns(find_saddles(picture(CHARUCO, TILTED, SIZE, noise=3.0)))
    ids, away = ids_of(found[0], CHARUCO, TILTED)
    corners = away < 1
    assert corners.sum() > 0.7 * CHARUCO.count  # 34 of 35 measured; any may be linked to a marker
    assert is_block(np.where(corners, ids, -1), CHARUCO)


def test_noise_has_no_pattern():
    noise = np.random.default_rng(0).integers(0, 256, (300, 400)).astype(np.uint8)
    found = patterns(find_saddles(noise))
    assert sum(grid.shape[0] * grid.shape[1] for grid in found) < 30


def test_of_two_boards_the_larger_in_the_image_comes_first():
    small = pose([(22.0, 17.0), (82.0, 17.0), (82.0, 57.0), (22.0, 57.0)])
    image = np.hstack([picture(BOARD, small, (105, 300), blur=0.5), picture(BOARD, TILTED, SIZE)])
    first, second = patterns(find_saddles(image))[:2]
    assert np.nanmin(first[..., 0]) > 105 > np.nanmax(second[..., 0])
