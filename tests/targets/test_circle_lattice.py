"""Lattices grown from ellipses among others that belong to none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camcal.targets.board_types import grid_points
from camcal.targets.ellipses import Ellipses, find_ellipses, lattices, places, square_roots

COLUMNS, ROWS = 8, 6


def seen(points, radius, tilt, turn):
    """Return the ellipses of discs on a plane tilted by an angle and turned in itself, to first order."""
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    flat = (points - points.mean(axis=0)) @ spin.T
    depth = 1 + 0.05 * np.sin(tilt) * flat[:, :1]
    squash = np.array([np.cos(tilt), 1])
    slope = np.einsum("nij,jk->nik", np.stack([np.diag(squash)] * len(flat)), spin) / depth[:, :, None]
    slope[:, :, :] -= np.einsum("ni,k->nik", flat * squash / depth**2, 0.05 * np.sin(tilt) * spin[0])
    axes = 40 * radius * square_roots(slope @ slope.swapaxes(1, 2))
    return Ellipses(320 + 40 * flat * squash / depth, axes)


@pytest.mark.slow
@given(tilt=st.floats(0, 1.2), turn=st.floats(0, 6.28), seed=st.integers(0, 1000))
def test_the_whole_board_is_one_lattice_among_clutter(tilt, turn, seed):
    rng = np.random.default_rng(seed)
    board = seen(grid_points(COLUMNS, ROWS), 0.3, tilt, turn)
    others = Ellipses(rng.uniform(0, 640, (40, 2)), rng.uniform(2, 12, (40, 1, 1)) * np.eye(2))
    far = np.linalg.norm(others.centres[:, None] - board.centres, axis=2).min(axis=1) > 30
    mixed = Ellipses(
        np.concatenate([board.centres, others.centres[far]]), np.concatenate([board.axes, others.axes[far]])
    )
    lattice = max(lattices(mixed, 20), key=lambda found: (found >= 0).sum())
    index = np.full((COLUMNS * ROWS,), False)
    index[lattice[(lattice >= 0) & (lattice < COLUMNS * ROWS)]] = True
    assert index.all()
    ordered = places(mixed, lattice)
    row, column = np.argwhere(lattice == 9)[0]  # not on the rim: all its neighbours are there
    steps = ordered[row, column + 1] - ordered[row, column], ordered[row + 1, column] - ordered[row, column]
    assert np.linalg.det(steps) > 0


def test_nothing_comes_of_too_few_ellipses():
    few = Ellipses(np.array([[10.0, 10.0], [30.0, 10.0], [20.0, 90.0]]), np.tile(4 * np.eye(2), (3, 1, 1)))
    assert list(lattices(few, 20)) == []


def test_squares_and_streaks_are_no_ellipses():
    gray = np.full((120, 200), 200, np.uint8)
    gray[40:64, 20:44] = 30  # a square
    gray[50:54, 70:120] = 30  # a streak
    y, x = np.mgrid[0:120, 0:200]
    gray[((x - 150.5) / 14) ** 2 + ((y - 52.2) / 9) ** 2 < 1] = 30
    found = find_ellipses(gray, 61, bright=False)
    np.testing.assert_allclose(found.centres, [[150.5, 52.2]], atol=0.2)
    np.testing.assert_allclose(found.axes, [np.diag([14, 9])], atol=1.2)  # the threshold is nearer to white
