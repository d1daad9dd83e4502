"""The outlines of black cells are those of the cells, whatever their arrangement."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from camcal.targets.printing import outlines


def around(black):
    return outlines(np.arange(black.shape[1] + 1.0), np.arange(black.shape[0] + 1.0), black)


def area(outline):
    """Return the area inside an outline, positive if it runs clockwise with y down."""
    x, y = outline.T
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_outlines_hold_the_black_cells_and_nothing_else(black):
    loops = around(black)
    rows, columns = np.indices(black.shape) + 0.5
    turns = np.zeros(black.shape)
    for loop in loops:  # how often a loop winds around a cell: upright sides to its left, up less down
        for (x, start), (_, end) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            crossed = (min(start, end) < rows) & (rows < max(start, end)) & (x < columns)
            turns += np.where(crossed, np.sign(start - end), 0)
    assert np.array_equal(turns, black)
    assert sum(map(area, loops)) == black.sum()


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_level_and_upright_edges_alternate(black):
    for loop in around(black):
        moved = np.roll(loop, -1, axis=0) != loop
        assert np.array_equal(moved.sum(axis=1), np.ones(len(loop)))
        assert np.array_equal(moved[:, 0], ~np.roll(moved[:, 0], 1))


def test_squares_that_touch_at_a_corner_have_outlines_of_their_own():
    assert [loop.tolist() for loop in around(np.eye(2, dtype=bool))] == [
        [[1, 0], [1, 1], [0, 1], [0, 0]],
        [[2, 1], [2, 2], [1, 2], [1, 1]],
    ]


@pytest.mark.parametrize(
    ("black", "areas"), [(np.ones((2, 3), bool), [6]), (np.pad([[False]], 1, constant_values=True), [9, -1])]
)
def test_cells_that_share_a_side_have_one_outline_and_one_around_a_hole(black, areas):
    assert [area(loop) for loop in around(black)] == areas
