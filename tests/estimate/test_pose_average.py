"""The mean of poses: Karcher's against scipy, weights, covariances that hold, and outliers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from camcal.errors import InsufficientData, InvalidInput
from camcal.estimate.pose_average import _MeanProblem, average_poses
from camcal.geometry.pose import Pose

TRUTH = Pose.from_vector(np.array([0.4, -1.0, 0.7]), np.array([1.0, -2.0, 3.0]))


def noisy(count, sigma, seed=0):
    steps = np.random.default_rng(seed).normal(size=(count, 6)) * sigma
    return [TRUTH.retract(step) for step in steps]


def step_from(truth, pose):
    return np.concatenate([pose.translation - truth.translation, (pose @ truth.inverse()).vector()])


def test_the_mean_is_where_the_steps_to_all_add_up_to_nothing():
    poses = noisy(20, 0.3)
    found = average_poses(poses)
    steps = np.array([step_from(found.pose, pose) for pose in poses])
    np.testing.assert_allclose(steps[:, 3:].sum(axis=0), 0, atol=1e-6)  # the definition of Karcher's mean
    np.testing.assert_allclose(found.pose.translation, np.mean([pose.translation for pose in poses], axis=0))
    assert found.unique


def test_of_close_rotations_it_is_scipys_chordal_mean():
    poses = noisy(20, 1e-3)
    found = average_poses(poses)
    chordal = Rotation.from_matrix([pose.rotation for pose in poses]).mean().as_matrix()
    np.testing.assert_allclose(found.pose.rotation, chordal, atol=1e-8)  # they differ by the cube of 1e-3


def test_half_way_between_two_rotations_by_hand():
    poses = [Pose.from_vector(np.array([0, 0, angle]), np.zeros(3)) for angle in (0.2, 1.0)]
    np.testing.assert_allclose(average_poses(poses).pose.vector(), [0, 0, 0.6], atol=1e-9)


def test_covariances_weigh_as_in_one_dimension():
    poses = [Pose(np.eye(3), np.array([x, 0, 0])) for x in (0.0, 1.0)]
    found = average_poses(poses, [np.eye(6) * 1.0, np.eye(6) * 3.0])
    # 3 to 1: the mean is a quarter of the way, its variance 1 / (1/1 + 1/3)
    assert found.pose.translation[0] == pytest.approx(0.25)
    np.testing.assert_allclose(found.covariance, 0.75 * np.eye(6), atol=1e-9)
    assert found.chi_square == pytest.approx(1 / 4)
    assert found.degrees_of_freedom == 6


def test_the_covariance_holds_what_it_says():
    rng = np.random.default_rng(7)
    roots = [rng.normal(size=(6, 6)) * 0.02 for _ in range(6)]
    covariances = [root @ root.T for root in roots]
    squared = []
    for _ in range(40):
        poses = [TRUTH.retract(root @ rng.normal(size=6)) for root in roots]
        found = average_poses(poses, covariances)
        off = step_from(TRUTH, found.pose)
        squared.append(off @ np.linalg.solve(found.covariance, off))
    # the mean of 40 values of 6 degrees of freedom is 6 ± √(12/40); four of these
    assert np.mean(squared) == pytest.approx(6, abs=2.2)


def test_without_covariances_the_scatter_gives_that_of_the_mean():
    count, sigma = 400, 0.01
    found = average_poses(noisy(count, sigma))
    # a standard deviation of 400 samples is known to 1/√800, 3.5 %; four of these
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigma / np.sqrt(count), rtol=0.14)


def test_few_poses_say_nothing_of_correlations():
    found = average_poses(noisy(4, 0.01))
    np.testing.assert_array_equal(found.covariance, np.diag(np.diag(found.covariance)))
    assert np.count_nonzero(average_poses(noisy(8, 0.01)).covariance) == 36


def test_outliers_hardly_move_the_robust_mean():
    rng, sigma = np.random.default_rng(8), 0.01
    wrong = [Pose.from_vector(rng.normal(size=3), 5 * rng.normal(size=3)) for _ in range(12)]
    poses = [*noisy(28, sigma), *wrong]
    clean = step_from(TRUTH, average_poses(poses[:28]).pose)
    robust = average_poses(poses, robust=True)
    off = step_from(TRUTH, robust.pose)
    assert np.linalg.norm(off) < np.linalg.norm(clean) + 0.5 * sigma  # 30 % outliers shift by less than half a sigma
    assert np.linalg.norm(step_from(TRUTH, average_poses(poses).pose)) > 10 * sigma
    assert robust.weights[:28].min() > 10 * robust.weights[28:].max()


def test_the_robust_mean_of_few_poses_that_nearly_agree_is_where_they_are():
    poses = [Pose(np.eye(3), np.array([x, 0, 0])) for x in (1.0, 1.001, 0.999, 5.0)]
    assert average_poses(poses, robust=True).pose.translation[0] == pytest.approx(1.0, abs=5e-4)


def test_rotations_all_around_have_no_single_mean():
    poses = [Pose.from_vector(np.array([0, 0, angle]), np.zeros(3)) for angle in (0.0, 2.0, -2.0)]
    assert not average_poses(poses).unique


def test_poses_that_are_the_same_have_that_one_as_their_mean():
    found = average_poses([TRUTH] * 3, robust=True)
    np.testing.assert_allclose(found.pose.matrix(), TRUTH.matrix(), atol=1e-12)


def test_one_pose_is_too_few_and_an_exact_one_is_refused():
    with pytest.raises(InsufficientData, match="two or more"):
        average_poses([TRUTH])
    with pytest.raises(InvalidInput, match="singular"):
        average_poses([TRUTH, TRUTH], [np.zeros((6, 6)), np.eye(6)])


def test_the_steps_to_the_poses_change_with_the_mean_as_their_jacobian_says():
    poses = noisy(3, 0.8)  # far apart, where left and right Jacobians differ
    rotations = np.array([pose.rotation for pose in poses])
    translations = np.array([pose.translation for pose in poses])
    problem = _MeanProblem(rotations, translations, np.broadcast_to(np.eye(6), (3, 6, 6)), None)
    (block,), h = problem.blocks(TRUTH), 1e-6
    numeric = [
        (problem.blocks(TRUTH.retract(h * axis))[0].residuals - problem.blocks(TRUTH.retract(-h * axis))[0].residuals)
        / (2 * h)
        for axis in np.eye(6)
    ]
    # central differences at h = 1e-6 are good to 1e-9
    np.testing.assert_allclose(block.shared[0].values, np.stack(numeric, axis=-1), atol=1e-8)
