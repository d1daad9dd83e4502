"""Boards that are moved before a camera."""

from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose


def between(first, last, share):
    """Return the pose a share of the way from one to another, turned at an even rate."""
    turn = so3.log(last.rotation @ first.rotation.T)
    return Pose(so3.exp(share * turn) @ first.rotation, (1 - share) * first.translation + share * last.translation)
