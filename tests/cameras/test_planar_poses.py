"""First poses of planes: exact for exact rays, whatever the lens and wherever the plane is."""

import numpy as np
import pytest

from camcal.cameras.observations import planar_poses
from camcal.geometry import rotation as so3

GRID = np.array([(x, y, 0.0) for y in np.linspace(-1, 1, 4) for x in np.linspace(-1, 1, 5)])


def rays_of(rotations, translations):
    """Return unit rays (3, W, N) through the grid in poses."""
    seen = GRID @ rotations.swapaxes(1, 2) + translations[:, None]
    return (seen / np.linalg.norm(seen, axis=2, keepdims=True)).transpose(2, 0, 1)


def scenes(count, centre, seed=0):
    rng = np.random.default_rng(seed)
    return so3.exp(0.7 * rng.normal(size=(count, 3))), np.asarray(centre) + 0.3 * rng.normal(size=(count, 3))


@pytest.mark.parametrize("centre", [(0, 0, 5), (6, 1, -2), (0, -3, 0)], ids=["ahead", "behind", "beside"])
def test_exact_rays_give_the_pose(centre):
    rotations, translations = scenes(20, centre)
    points = np.broadcast_to(GRID.T[:, None], (3, 20, len(GRID)))
    found, places = planar_poses(rays_of(rotations, translations), points, np.ones((20, len(GRID)), bool))
    np.testing.assert_allclose(found, rotations, atol=1e-7)
    np.testing.assert_allclose(places, translations, atol=1e-6)


def test_points_that_are_not_there_do_not_count():
    rotations, translations = scenes(1, (0, 0, 4), seed=3)
    rays, mask = rays_of(rotations, translations), np.ones((1, len(GRID)), bool)
    rays[:, 0, 5:9], mask[0, 5:9] = [[0.0], [0.6], [0.8]], False
    found, places = planar_poses(rays, GRID.T[:, None], mask)
    np.testing.assert_allclose(found, rotations, atol=1e-7)
    np.testing.assert_allclose(places, translations, atol=1e-6)


def test_rays_that_are_all_one_are_no_error():
    rays = np.tile(np.array([0.0, 0.0, 1.0])[:, None, None], (1, 1, len(GRID)))
    found, _ = planar_poses(rays, GRID.T[:, None], np.ones((1, len(GRID)), bool))
    assert np.linalg.det(found[0]) == pytest.approx(1)
