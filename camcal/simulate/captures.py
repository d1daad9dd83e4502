"""Poses of a board that is held in front of one camera of a rig after another, where another one has it too."""

from collections.abc import Sequence
from itertools import chain

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Rig
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.scene import seen, views
from camcal.targets.board import Board

ROUNDS = 20  # of proposals, as many as captures are wanted from every camera
LEAST_CAMERAS = 2


def captures(rig: Rig, board: Board, count: int, *, rng: np.random.Generator, partial: bool = False) -> list[Pose]:
    """Return `count` poses rig_T_board that two cameras see the whole board at, or with `partial` enough of it.

    Raises InvalidInput if there are not enough such poses: the cameras have no view in common.
    """
    found: list[Pose] = []
    for _ in range(ROUNDS):
        proposed = [
            [rig.rig_T_camera[name] @ pose for pose in views(camera, board, count, rng=rng, partial=partial)]
            for name, camera in rig.cameras.items()
        ]
        in_turn = list(chain(*zip(*proposed, strict=True)))
        sharing = np.sum([seen_by(rig, name, board, in_turn, partial=partial) for name in rig.cameras], axis=0)
        found += [pose for pose, cameras in zip(in_turn, sharing, strict=True) if cameras >= LEAST_CAMERAS]
        if len(found) >= count:
            return found[:count]
    raise InvalidInput(
        f"found {len(found)} of {count} poses of the board ({board.words}) that two cameras see: use a smaller board, "
        "--partial, or cameras with more in common"
    )


def seen_by(rig: Rig, name: str, board: Board, poses: Sequence[Pose], *, partial: bool) -> Array:
    """Return the mask (V,) of poses rig_T_board at which a camera sees the board."""
    camera_T_rig = rig.rig_T_camera[name].inverse()
    return seen(rig.cameras[name], board, [camera_T_rig @ pose for pose in poses], partial=partial)
