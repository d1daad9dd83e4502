"""Normal equations of blocks that are summed up in parts against products of one matrix; the lowest place of a step."""

import numpy as np
import pytest

from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian, lowest_along

GROUPS, ROWS, SIZE, DENSE, POINTS = 90, 100, 2, 3, 5  # 9 000 rows: several parts


def problem(rng, *, alike):
    """Return a block with columns that all rows share and columns of single points, and its whole matrix.

    alike: whether every group has all points in the same order.
    """
    count = GROUPS * ROWS
    group, lens, own = (rng.normal(size=(count, 2, columns)) for columns in (SIZE, DENSE, 2))
    residuals, weights = rng.normal(size=(count, 2)), rng.uniform(0.5, 2, count)
    points = np.tile(np.arange(ROWS), GROUPS) if alike else rng.integers(POINTS, size=count)
    shared = DENSE + 2 * (points.max() + 1)
    columns = DENSE + 2 * points[:, None] + np.arange(2)
    parts = Jacobian(lens, np.arange(DENSE)), Jacobian(own, columns)
    block = Block(residuals, parts, group, rows_per_group=ROWS, weights=weights)
    matrix = np.zeros((count, 2, shared))
    matrix[:, :, :DENSE] = lens
    matrix[np.arange(count)[:, None, None], np.arange(2)[:, None], columns[:, None, :]] = own
    return block, matrix, group, shared


@pytest.mark.parametrize("alike", [True, False])
def test_parts_add_up_to_the_products_of_the_whole_matrix(alike):
    block, matrix, group, shared = problem(np.random.default_rng(3), alike=alike)
    found = assemble([block], shared, GROUPS, SIZE)
    root = np.sqrt(block.weights)[:, None, None]
    flat, right = (root * matrix).reshape(-1, shared), (root[:, 0] * block.residuals).ravel()
    np.testing.assert_allclose(found.shared_shared, flat.T @ flat, atol=1e-9 * GROUPS * ROWS)
    np.testing.assert_allclose(found.gradient.shared, flat.T @ right, atol=1e-9 * GROUPS * ROWS)
    assert found.cost == pytest.approx(0.5 * right @ right)
    by_view, by_group = flat.reshape(GROUPS, -1, shared), (root * group).reshape(GROUPS, -1, SIZE)
    errors = right.reshape(GROUPS, -1)
    np.testing.assert_allclose(found.group_shared, by_group.swapaxes(1, 2) @ by_view, atol=1e-9 * ROWS)
    np.testing.assert_allclose(found.group_group, by_group.swapaxes(1, 2) @ by_group, atol=1e-9 * ROWS)
    np.testing.assert_allclose(found.gradient.groups, np.einsum("gri,gr->gi", by_group, errors), atol=1e-9 * ROWS)
    np.testing.assert_allclose(found.group_gradients, np.einsum("gri,gr->gi", by_view, errors), atol=1e-9 * ROWS)
    products = by_view[:, :, :DENSE].swapaxes(1, 2) @ by_view[:, :, :DENSE]
    np.testing.assert_allclose(found.group_products, products, atol=1e-9 * ROWS)


@pytest.mark.parametrize("share", [0.1, 0.7, 1.0, 3.0])
def test_a_parabola_is_lowest_where_two_of_its_places_say(share):
    slope, curvature = -3.0, 4.0  # lowest at 0.75
    change = slope * share + 0.5 * curvature * share**2
    assert lowest_along(-slope / 2, share, change) == pytest.approx(0.75)


def test_a_cost_that_curves_downwards_is_followed_as_far_as_it_was_seen():
    assert lowest_along(1.0, 0.5, -1.5) == 0.5
