"""What a grid of corners says of its nodes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from camcal.targets import grid as grids

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
    np.testing.assert_allclose(grids.predict(grid), grid, atol=1e-9)
    assert np.nanmax(grids.stray(grid)) < 1e-9


def test_a_missing_corner_is_put_where_it_belongs():
    grid = curved(np.linspace(-3, 3, 12))
    holes = grid.copy()
    holes[2, 3] = holes[0, 0] = holes[4, 6] = np.nan
    missing = np.isnan(holes)
    np.testing.assert_allclose(grids.predict(holes)[missing], grid[missing], atol=1e-9)


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


def test_a_mirrored_grid_is_made_right_handed_and_a_right_handed_one_left_alone():
    grid = regular()
    np.testing.assert_array_equal(grids.right_handed(grid), grid)
    np.testing.assert_array_equal(grids.right_handed(np.rot90(grid)), np.rot90(grid))
    for mirrored in (grid[:, ::-1], grid[::-1], grid.swapaxes(0, 1)):
        turned = grids.right_handed(mirrored)
        assert np.linalg.det(grids.steps(turned)).min() > 0


def test_rightness_is_the_cosine_of_the_rows_direction():
    assert grids.rightness(regular()) == 1
    assert grids.rightness(regular()[::-1, ::-1]) == -1
    assert abs(grids.rightness(np.rot90(regular()))) < 1e-12
