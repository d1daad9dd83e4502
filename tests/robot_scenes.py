"""Robots that move a camera before a board, and the files that they are written to."""

import numpy as np

from camcal.calibrate.robot.problem import Poses
from camcal.formats.pose_text import form_named
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose

CARRIER = Pose.from_vector(np.array([0.1, -0.2, 1.5]), np.array([0.05, -0.02, 0.08]))
WORLD = Pose.from_vector(np.array([0.02, 3.1, 0.03]), np.array([0.6, 0.1, 0.02]))


def stacked(poses):
    return Poses(np.stack([pose.rotation for pose in poses]), np.stack([pose.translation for pose in poses]))


def noisy(poses, shift, turn, rng):
    """Poses with noise of position (m) and rotation (rad)."""
    return [
        Pose(pose.rotation @ so3.exp(rng.normal(0, turn, 3)), pose.translation + rng.normal(0, shift, 3))
        for pose in poses
    ]


def hand_of(camera_T_board):
    """The exact poses base_T_hand of poses of the board."""
    return [WORLD @ pose.inverse() @ CARRIER.inverse() for pose in camera_T_board]


def board_at(time):
    """The pose camera_T_board of a camera that moves all the time, at a time in s."""
    turn = np.array([0.5 * np.sin(0.9 * time), 0.4 * np.sin(1.3 * time + 1), 1.2 * np.sin(0.5 * time + 2)])
    place = np.array([0.06 * np.sin(1.1 * time), 0.05 * np.cos(0.8 * time), 0.5 + 0.1 * np.sin(0.6 * time)])
    return Pose(so3.exp(turn), place - so3.exp(turn) @ np.array([0.1, 0.06, 0.0]))


def write_poses(path, poses, form="ros", *, before=None, scale=1.0):
    """Write a pose a line; before: names or times, one for each."""
    rows = []
    for place, pose in enumerate(poses):
        numbers = form_named(form).numbers(Pose(pose.rotation, scale * pose.translation)).tolist()
        if form == "tum":
            numbers[0] = before[place]
        elif before is not None:
            rows.append(f"{before[place]},{','.join(map(repr, numbers))}")
            continue
        rows.append(" ".join(map(repr, numbers)))
    path.write_text("\n".join(rows) + "\n")
