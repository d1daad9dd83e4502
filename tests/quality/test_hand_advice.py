"""What poses of a robot's hand say of hand and eye, against differences; poses that are suggested beside others."""

import numpy as np
import pytest

from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality import hand_advice
from camcal.quality.hand_advice import HandEye, advise_hand
from camcal.quality.view_advice import Known, candidates
from camcal.targets.board import Board, Surface

CAMERA = Camera(model_named("opencv4"), (640, 480), [500.0, 501, 320, 240, -0.1, 0.02, 1e-4, -2e-4], np.eye(8) * 1e-4)
KNOWN = Known(CAMERA, Surface.flat(Board("chessboard", 8, 5, 0.03)), 0.1, (0.3, 0.6))
X = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.05, -0.02, 0.08]))
Z = Pose.from_vector(np.array([0.02, 3.1, 0.03]), np.array([0.6, 0.1, 0.02]))
SEEN = Pose.from_vector(np.array([0.3, -0.4, 0.2]), np.array([-0.1, -0.05, 0.5]))
NOISE = (5e-4, 8e-4)


def known_as(in_hand):
    spread = np.random.default_rng(3).normal(0, 1e-3, (12, 12))
    return HandEye(X, Z, spread @ spread.T, NOISE, in_hand)


def moved(pose, change):
    return Pose(so3.exp(change[3:]) @ pose.rotation, pose.translation + change[:3])


def derivative(function, pose):
    """The derivatives (6, 6) of a pose, position and rotation vector on the left, by those of another one."""
    start, columns = function(pose), []
    for step in 1e-6 * np.eye(6):
        ends = [function(moved(pose, side * step)) for side in (1, -1)]
        apart = [
            np.append(end.translation - start.translation, so3.log(end.rotation @ start.rotation.T)) for end in ends
        ]
        columns.append((apart[0] - apart[1]) / 2e-6)
    return np.column_stack(columns)


@pytest.mark.parametrize("in_hand", [True, False])
def test_what_a_pose_says_is_as_by_differences(in_hand):
    carried = Z @ SEEN.inverse() @ X.inverse()
    corners = hand_advice._seen(KNOWN, SEEN)
    by_both = np.hstack(
        [
            derivative(lambda pose: Z @ SEEN.inverse() @ pose.inverse(), X),
            derivative(lambda pose: pose @ SEEN.inverse() @ X.inverse(), Z),
        ]
    )
    by_view = derivative(lambda pose: Z @ pose.inverse() @ X.inverse(), SEEN)
    by_robot = np.eye(6) if in_hand else derivative(lambda pose: pose.inverse(), carried.inverse())
    noise = by_view @ corners @ by_view.T + by_robot @ np.diag(np.repeat(NOISE, 3) ** 2) @ by_robot.T
    expected = by_both.T @ np.linalg.solve(noise, by_both)
    found = hand_advice._information(KNOWN, known_as(in_hand), SEEN, carried)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_corners_say_of_the_pose_of_the_board_what_their_noise_leaves():
    points = KNOWN.surface.points()
    columns = [
        CAMERA.project(moved(SEEN, step).apply(points)).pixels - CAMERA.project(moved(SEEN, -step).apply(points)).pixels
        for step in 1e-6 * np.eye(6)
    ]
    jacobian = np.column_stack([column.ravel() for column in columns]) / 2e-6
    expected = 0.1**2 * np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(hand_advice._seen(KNOWN, SEEN), expected, rtol=1e-4, atol=1e-12)


@pytest.mark.parametrize("in_hand", [True, False])
def test_suggested_poses_are_better_than_any_of_two_hundred_random_choices(in_hand):
    hand_eye = known_as(in_hand)
    found, rng = advise_hand(KNOWN, hand_eye, 3), np.random.default_rng(4)
    every = candidates(KNOWN)
    carried = [Z @ (X @ pose).inverse() for pose in every.poses]
    middle = X.rotation @ np.append(np.zeros(2), np.mean(every.distances))
    reach = np.hstack([np.eye(3), -so3.hat(middle), np.zeros((3, 6))])
    pairs = zip(every.poses, carried, strict=True)
    information = np.stack([hand_advice._information(KNOWN, hand_eye, *pair) for pair in pairs])

    def std_after(chosen):
        total = np.linalg.inv(hand_eye.covariance) + information[list(chosen)].sum(axis=0)
        return np.sqrt(np.trace(reach @ np.linalg.solve(total, reach.T)))

    drawn = [std_after(rng.choice(len(carried), 3, replace=False)) for _ in range(200)]
    assert found.poses[-1].std_m <= min(drawn) * (1 + 1e-9)
    assert found.std_m == pytest.approx(std_after(()), rel=1e-6)
    assert found.std_m > found.poses[0].std_m > found.poses[1].std_m > found.poses[2].std_m
    for each in found.poses:
        hand = Z @ (X @ each.view.pose).inverse()
        expected = hand if in_hand else hand.inverse()
        np.testing.assert_allclose(each.base_T_hand.matrix(), expected.matrix(), atol=1e-12)
