"""Which poses a robot's hand should take next, for hand and eye to be known best.

A pose adds what the robot and the camera say of where the camera and the board stand. With X, Z and C = camera_T_board
the hand is at Z C⁻¹ X⁻¹: X = hand_T_camera and Z = base_T_board of a camera in the hand, where that is base_T_hand;
X = base_T_camera and Z = hand_T_board of one beside the robot, where it is hand_T_base. Source: Pukelsheim, Optimal
Design of Experiments, 1993 (linear criteria).
"""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.directions import covariance_root
from camcal.dataclass import dataclass
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.quality.view_advice import Known, SuggestedView, candidates, choose, suggest
from camcal.records import Brief


@dataclass(frozen=True, eq=False)
class HandEye:
    """Hand and eye as they are known: X and Z with their covariance (12, 12), tx … rz of X and of Z, m and rad.

    noise: standard deviations of the robot's position (m) and rotation (rad). in_hand: whether the camera is.
    """

    X: Pose
    Z: Pose
    covariance: Array
    noise: tuple[float, float]
    in_hand: bool


@dataclass(frozen=True, eq=False)
class SuggestedPose(Brief):
    """A pose of the hand that is worth taking, and the view of the board from it. std_m: as of HandAdvice, after it."""

    base_T_hand: Pose
    view: SuggestedView
    std_m: float


@dataclass(frozen=True, eq=False)
class HandAdvice(Brief):
    """std_m: of the place, by X, of the middle of a board as it was seen (RMS of three coordinates' sum), as known."""

    std_m: float
    poses: tuple[SuggestedPose, ...]


def advise_hand(known: Known, hand_eye: HandEye, count: int = 3) -> HandAdvice:
    """Return the poses of the hand to take next; raises InsufficientData where no view of the board fits the image."""
    found = candidates(known)
    carried = [hand_eye.Z @ (hand_eye.X @ pose).inverse() for pose in found.poses]
    information = np.stack([_information(known, hand_eye, *pair) for pair in zip(found.poses, carried, strict=True)])
    middle = np.append(np.zeros(2), np.mean(found.distances))
    reach = np.hstack([np.eye(3), -so3.hat(hand_eye.X.rotation @ middle), np.zeros((3, 6))])
    root = covariance_root(hand_eye.covariance)
    metric = 2 * root.T @ (reach.T @ reach) @ root  # `choose` takes the mean of two directions
    order, stds = choose(root.T @ information @ root, metric, count)
    poses = [carried[index] if hand_eye.in_hand else carried[index].inverse() for index in order]
    views = [suggest(found, index, std) for index, std in zip(order, stds, strict=True)]
    chosen = [SuggestedPose(pose, view, std) for pose, view, std in zip(poses, views, stds, strict=True)]
    return HandAdvice(float(np.sqrt(np.trace(metric) / 2)), tuple(chosen))


def _seen(known: Known, camera_T_board: Pose) -> Array:
    """Return the covariance (6, 6) of a pose of the board by the noise of its corners, lens and board as they are."""
    points = camera_T_board.apply(known.surface.points())
    turning = so3.hat(points - camera_T_board.translation)
    turned = np.concatenate([np.broadcast_to(np.eye(3), turning.shape), -turning], axis=2)
    by_pose = known.camera.project_with_jacobians(points).d_point @ turned
    return np.asarray(known.noise_px**2 * np.linalg.inv(np.einsum("nki,nkj->ij", by_pose, by_pose)))


def _information(known: Known, hand_eye: HandEye, camera_T_board: Pose, carried: Pose) -> Array:
    """Return what a pose says (12, 12) of X and Z; carried: Z C⁻¹ X⁻¹.

    The derivatives are of position and rotation vector, on the left, of the three poses alike.
    """
    X, Z, turn = hand_eye.X, hand_eye.Z, carried.rotation
    base_T_camera = Z.rotation @ camera_T_board.rotation.T
    away = X.inverse().translation - camera_T_board.translation
    by_X = _blocks(-turn, so3.hat(-turn @ X.translation) @ turn, -turn)
    by_Z = _blocks(np.eye(3), -so3.hat(carried.translation - Z.translation), np.eye(3))
    by_view = _blocks(-base_T_camera, base_T_camera @ so3.hat(away), -base_T_camera)
    by_robot = np.eye(6)
    if not hand_eye.in_hand:  # the robot's noise is of base_T_hand
        back = carried.inverse()
        by_robot = _blocks(-turn, turn @ so3.hat(-back.translation), -turn)
    std = np.repeat(hand_eye.noise, 3)
    noise = by_view @ _seen(known, camera_T_board) @ by_view.T + (by_robot * std**2) @ by_robot.T
    by_both = np.hstack([by_X, by_Z])
    return np.asarray(by_both.T @ np.linalg.solve(noise, by_both))


def _blocks(place: Array, place_by_turn: Array, turn: Array) -> Array:
    """Return the derivatives (6, 6) of a pose by another one: of its place by place and rotation, of its rotation."""
    return np.block([[place, place_by_turn], [np.zeros((3, 3)), turn]])
