"""Poses smoothed on SO(3) × R³."""

from dataclasses import replace

import numpy as np
import pytest

from camcal.errors import InsufficientData
from camcal.estimate.smoothing.linear_system import MotionModel
from camcal.estimate.smoothing.poses import PoseGuess, PoseProblem, PosesOptions, poses_at, smooth_poses
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Trajectory
from camcal.solve.differentiate import central_jacobian

DT, COUNT = 1 / 30, 120
Q = (0.02, 0.5)
STD = np.array([0.01, 0.01, 0.03, 0.05, 0.05, 0.05])


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def truth(rng):
    """Return stamps, positions (K, 3), rotations (K, 3, 3) and rates (K, 3) of something that moves and turns."""
    noise = MotionModel().noise(np.array([DT]))[0]
    roots = [np.linalg.cholesky(q * noise) for q in Q]
    place, rotation, rate = np.array([[0.0, 0, 1], [0.2, -0.1, 0.1]]), np.eye(3), rng.normal(size=3)
    rows = []
    for _ in range(COUNT):
        rows.append((place[0].copy(), rotation, rate))
        shift, turn = (root @ rng.normal(size=(2, 3)) for root in roots)
        place = np.array([place[0] + DT * place[1], place[1]]) + shift
        rotation, rate = so3.exp(turn[0]) @ so3.exp(DT * rate) @ rotation, rate + turn[1]
    return (np.arange(COUNT) * DT, *map(np.array, zip(*rows, strict=True)))


def measured(rng, stamps, positions, rotations, kept=slice(None)):
    steps = rng.normal(size=(len(stamps), 6)) * STD
    return Trajectory(
        "camera_T_object",
        stamps[kept],
        (so3.exp(steps[:, 3:]) @ rotations)[kept],
        (positions + steps[:, :3])[kept],
        np.tile(np.diag(STD**2), (len(stamps), 1, 1))[kept],
    )


def errors(found, positions, rotations):
    return np.hstack([positions - found.translations, so3.log(rotations @ np.swapaxes(found.rotations, 1, 2))])


def test_poses_become_better_and_their_covariances_say_by_how_much(rng):
    stamps, positions, rotations, rates = truth(rng)
    kept = np.sort(rng.choice(COUNT, 105, replace=False))
    poses = measured(rng, stamps, positions, rotations, kept)
    found = smooth_poses(poses, PosesOptions(q=Q))
    after = errors(found.trajectory, positions[kept], rotations[kept])
    before = errors(poses, positions[kept], rotations[kept])
    assert (np.sqrt(np.mean(after**2, axis=0)) < 0.5 * np.sqrt(np.mean(before**2, axis=0))).all()
    nees = np.einsum("ki,kij,kj->k", after, np.linalg.inv(found.trajectory.covariances), after) / 6
    assert 0.6 < nees.mean() < 1.5  # errors of neighbours are alike: some 30 independent ones
    assert found.consistency.verdict == "consistent"
    assert np.mean(np.abs(found.trajectory.velocities[:, 3:] - rates[kept])) < 0.3  # rates are known to about 0.2


def test_rts_and_batch_give_the_same_poses(rng):
    stamps, positions, rotations, _ = truth(rng)
    poses = measured(rng, stamps, positions, rotations)
    one, other = (smooth_poses(poses, PosesOptions(q=Q, method=method)).trajectory for method in ("rts", "batch"))
    np.testing.assert_allclose(one.translations, other.translations, atol=1e-9)
    np.testing.assert_allclose(one.rotations, other.rotations, atol=1e-9)
    np.testing.assert_allclose(one.covariances, other.covariances, atol=1e-9)


@pytest.mark.parametrize("model", ["rw", "ca"])
def test_other_models_smooth_poses_too(rng, model):
    stamps, positions, rotations, _ = truth(rng)
    poses = measured(rng, stamps, positions, rotations)
    found = smooth_poses(poses, PosesOptions(MotionModel(model), (1.0, 1.0) if model == "rw" else (10.0, 100.0)))
    after, before = (errors(each, positions, rotations) for each in (found.trajectory, poses))
    assert np.sqrt(np.mean(after**2)) < 0.9 * np.sqrt(np.mean(before**2))
    assert (found.trajectory.velocities is None) == (model == "rw")


@pytest.mark.parametrize("model", ["rw", "cv", "ca"])
def test_the_turning_of_a_rotations_error_is_its_derivative(rng, model):
    order = len(MotionModel(model).states)
    guess = PoseGuess(so3.exp(rng.normal(size=(2, 3))), rng.normal(size=(2, order - 1, 3)))
    poses = Trajectory("a_T_b", np.array([0.0, 0.4]), guess.rotations, np.zeros((2, 3)))
    system = PoseProblem.of(poses, MotionModel(model), None).system(guess)
    weights = [0.4, 0.4**2 / 2][: order - 1]

    def next_error(state):
        turn = sum((w * state[3 + 3 * k : 6 + 3 * k] for k, w in enumerate(weights)), np.zeros(3))
        predicted = so3.exp(turn) @ so3.exp(state[:3]) @ guess.rotations[0]
        return so3.log(predicted @ guess.rotations[1].T)

    at = np.concatenate([np.zeros(3), guess.rates[0].ravel()])
    left = -next_error(at)
    columns = np.concatenate([np.arange(3, 6), *(np.arange(6 * k + 3, 6 * k + 6) for k in range(1, order))])
    found = system.transitions[0][3:6][:, columns]
    # Log(Exp(δ) Exp(-e)) = -e + J(-e)⁻¹ δ, and δ stands behind Exp(e) where the next error is measured.
    expected = so3.exp(left) @ so3.exp_jacobian(-left) @ central_jacobian(next_error, at)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_noise_of_poses_is_found_without_their_covariances(rng):
    stamps, positions, rotations, _ = truth(rng)
    poses = replace(measured(rng, stamps, positions, rotations), covariances=None)
    found = smooth_poses(poses)
    assert found.sigma[0] == pytest.approx(np.sqrt(np.mean(STD[:3] ** 2)), rel=0.25)  # 3 σ over 360 numbers
    assert found.sigma[1] == pytest.approx(STD[3], rel=0.25)
    assert 0.1 < found.q[1] / Q[1] < 10  # 4 s of motion tell little of q


def test_a_pose_that_is_flipped_is_an_outlier(rng):
    stamps, positions, rotations, _ = truth(rng)
    poses = measured(rng, stamps, positions, rotations)
    wrong = poses.rotations.copy()
    wrong[40] = so3.about_x(2.0) @ wrong[40]
    found = smooth_poses(replace(poses, rotations=wrong), PosesOptions(q=Q, robust=True))
    assert np.flatnonzero(found.outliers).tolist() == [40]
    assert found.weights[40] < 0.1
    assert np.linalg.norm(errors(found.trajectory, positions, rotations)[40, 3:]) < 0.15  # 3 σ of a measured one


def test_poses_between_measurements_lie_on_the_smoothed_motion(rng):
    stamps, positions, rotations, _ = truth(rng)
    options = PosesOptions(q=Q)
    poses = measured(rng, stamps, positions, rotations, slice(None, None, 2))
    smoothed = smooth_poses(poses, options)
    found = poses_at(poses, smoothed, options, stamps[:-1])
    np.testing.assert_allclose(found.translations[::2], smoothed.trajectory.translations, atol=1e-8)
    # Noise of turning composes up to the turn within a step, here 3 % of it.
    np.testing.assert_allclose(found.rotations[::2], smoothed.trajectory.rotations, atol=5e-4)
    between = errors(found, positions[:-1], rotations[:-1])[1::2]
    limits = 5 * np.sqrt(np.einsum("kii->ki", found.covariances[1::2]))
    assert (np.abs(between) < limits).all()


def test_segments_are_smoothed_by_themselves_and_too_short_ones_named(rng):
    stamps, positions, rotations, _ = truth(rng)
    poses = measured(rng, stamps, positions, rotations)
    halves = replace(poses, segments=np.arange(COUNT) // 60)
    found = smooth_poses(halves, PosesOptions(q=Q)).trajectory
    alone = smooth_poses(poses.rows(np.arange(60)), PosesOptions(q=Q)).trajectory
    np.testing.assert_allclose(found.translations[:60], alone.translations, atol=1e-9)
    with pytest.raises(InsufficientData, match="velocity of segment 1 \\(1 poses"):
        smooth_poses(replace(poses, segments=(np.arange(COUNT) == COUNT - 1).astype(float)), PosesOptions(q=Q))
