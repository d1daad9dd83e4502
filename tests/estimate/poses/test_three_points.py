"""Three points: their exact poses, thousands at once, and triplets that have none."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from camcal.estimate.poses.starts import poses_of_triplets
from camcal.geometry import rotation as so3


def triplets(rng, count, flat):
    """Return rays, points and the states they were made with."""
    rotations = so3.exp(rng.normal(0, 1, (count, 3)))
    places = np.column_stack([rng.normal(0, 0.3, (count, 2)), rng.uniform(1, 5, count)])
    points = rng.normal(0, 0.5, (count, 3, 3)) * [1, 1, 0 if flat else 1]
    seen = np.einsum("tij,tkj->tki", rotations, points) + places[:, None]
    rays = seen / np.linalg.norm(seen, axis=2, keepdims=True)
    return rays, points, np.concatenate([rotations, places[:, :, None]], axis=2)


def misses(states, rays, points):
    """Return the largest angle between a ray and its point under each state."""
    seen = np.einsum("sij,skj->ski", states[:, :, :3], points) + states[:, None, :, 3]
    return np.abs(np.cross(rays, seen / np.linalg.norm(seen, axis=2, keepdims=True))).max(axis=(1, 2))


def test_every_triplet_finds_the_pose_it_was_seen_from():
    rng = np.random.default_rng(1)
    for flat in (False, True):
        rays, points, truth = triplets(rng, 2000, flat)
        states, which = poses_of_triplets(rays, points)
        error = np.full(len(rays), np.inf)
        np.minimum.at(error, which, np.abs(states - truth[which]).max(axis=(1, 2)))
        # a triplet near a double solution has the root of the rounding, 1e-8, as its error
        assert np.mean(error < 1e-9) > 0.99
        assert np.mean(error < 1e-5) > 0.999  # the rest are all but lines


def test_every_pose_found_meets_its_three_points():
    rng = np.random.default_rng(2)
    rays, points, _ = triplets(rng, 2000, flat=False)
    states, which = poses_of_triplets(rays, points)
    assert np.bincount(which).max() <= 4
    assert misses(states, rays[which], points[which]).max() < 1e-8  # as above
    np.testing.assert_allclose(np.linalg.det(states[:, :, :3]), 1, atol=1e-12)


def test_rays_without_any_pose_give_none_or_poses_that_meet_them():
    rng = np.random.default_rng(3)
    rays = rng.normal(size=(500, 3, 3))
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    points = rng.normal(size=(500, 3, 3))
    states, which = poses_of_triplets(rays, points)
    assert len(np.unique(which)) < 500
    assert np.quantile(misses(states, rays[which], points[which]), 0.99) < 1e-8  # the rest are near double solutions


def test_a_symmetric_triplet_seen_from_its_axis_has_all_four_poses():
    angles = np.radians([90, 210, 330])
    points = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])[None]
    seen = points + np.array([0, 0, 3.0])
    states, _ = poses_of_triplets(seen / np.linalg.norm(seen, axis=2, keepdims=True), points)
    assert len(states) == 4
    assert np.abs(states - np.eye(4)[:3] - [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 3]]).max(axis=(1, 2)).min() < 1e-9


def test_triplets_in_a_line_or_on_one_ray_have_no_pose():
    line = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]])
    seen = line + np.array([0, 0, 3.0])
    rays = seen / np.linalg.norm(seen, axis=2, keepdims=True)
    for directions, points in ((rays, line), (np.tile([0.0, 0, 1], (1, 3, 1)), np.eye(3)[None]), (rays, 0 * line)):
        states, _ = poses_of_triplets(directions, points)
        assert len(states) == 0 or np.isfinite(states).all()


@settings(max_examples=30)
@given(st.floats(-6, 6), st.integers(0, 1000))
def test_the_unit_of_the_points_does_not_matter(power, seed):
    rays, points, truth = triplets(np.random.default_rng(seed), 1, flat=False)
    scale = 10.0**power
    states, _ = poses_of_triplets(rays, scale * points)
    states[:, :, 3] /= scale
    assert np.abs(states - truth).max(axis=(1, 2)).min() < 1e-6  # a double solution would have 1e-8
