"""What a grid of corners says of its nodes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.targets.checker import proposals as grids

ROWS, COLUMNS = 5, 7
row, column = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
number = st.floats(-5, 5)


def regular(step=20.0):
    return np.stack([100 + step * column, 50 + step * row], axis=-1)


def curved(coefficients):
    powers = np.stack([np.ones_like(row), column, row, column**2, row**2, column * row], axis=-1)
    return regular() + powers @ np.reshape(coefficients, (6, 2)) * 0.1


@given(st.lists(number, min_size=12, max_size=12))
def test_a_quadratic_grid_predicts_itself(coefficients):
    grid = curved(coefficients)
    np.testing.assert_allclose(grids.predict(grid), grid, atol=1e-9)  # rounding
    assert np.nanmax(grids.stray(grid)) < 1e-9


def test_a_missing_corner_is_put_where_it_belongs():
    grid = curved(np.linspace(-3, 3, 12))
    holes = grid.copy()
    holes[2, 3] = holes[0, 0] = holes[4, 6] = np.nan
    missing = np.isnan(holes)
    np.testing.assert_allclose(grids.predict(holes)[missing], grid[missing], atol=1e-9)  # rounding


def test_a_wrong_neighbour_is_outvoted():
    grid = regular()
    wrong = grid.copy()
    wrong[2, 3] += 9
    away = np.linalg.norm(grids.predict(wrong) - grid, axis=-1)
    assert away[2, 3] < 1e-9
    assert np.unravel_index(np.argmax(grids.stray(wrong)), (ROWS, COLUMNS)) == (2, 3)
    assert (grids.stray(wrong) > 0.3).sum() == 1


def test_nothing_is_predicted_without_neighbours():
    grid = np.full((ROWS, COLUMNS, 2), np.nan)
    grid[0, 0] = grid[4, 6] = (1, 2)
    assert np.isnan(grids.predict(grid)).all()
    assert np.isnan(grids.stray(grid)).all()


def test_steps_lead_to_the_next_corner_along_the_row_and_down_the_column():
    found = grids.steps(regular())
    np.testing.assert_allclose(found, np.broadcast_to([[20.0, 0.0], [0.0, 20.0]], found.shape))
    np.testing.assert_allclose(grids.spacing(found), 20)


def test_a_lone_corner_takes_the_steps_of_the_whole():
    grid = np.full((ROWS, COLUMNS, 2), np.nan)
    for node in ((0, 0), (0, 4), (3, 1), (4, 6)):
        grid[node] = regular()[node]
    np.testing.assert_allclose(grids.steps(grid), grids.steps(regular()), atol=1e-9)


def test_a_grid_is_most_upright_with_rows_to_the_right_or_down_and_upside_down_the_other_way():
    grid = regular()
    assert grids.uprightness(grid) == pytest.approx(np.cos(np.radians(20)))
    assert grids.uprightness(np.rot90(grid, 1)) > 0  # its rows run down
    assert grids.uprightness(np.rot90(grid, 2)) < 0
    assert grids.uprightness(np.rot90(grid, 3)) < 0


def test_a_board_on_its_side_stays_upright_when_it_leans_to_either_side():
    for lean in np.radians([-15, 15]):
        turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])
        assert grids.uprightness(np.rot90(regular(), 1) @ turn.T) > 0


def test_the_area_of_a_grid_is_that_of_its_cells_missing_corners_left_out():
    grid = regular(20.0)
    assert grids.area(grid) == pytest.approx(ROWS * COLUMNS * 400)
    grid[0, 0] = np.nan
    assert grids.area(grid) == pytest.approx((ROWS * COLUMNS - 1) * 400)
    assert grids.area(np.full((2, 3, 2), np.nan)) == 0
