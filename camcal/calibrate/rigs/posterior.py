"""What a solution of a rig leaves open of single views: degrees of freedom that they spent, covariances of poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.problem import RigProblem, RigState
from camcal.calibrate.shape import spent_by_block
from camcal.geometry import rotation as so3
from camcal.solve.steps import Block, Factors, NormalEquations


@dataclass(frozen=True, eq=False)
class PartPosterior:
    """Of the V views of one camera. spent: (V,) degrees of freedom that their corners have spent, but for on_offsets
    (V,), those on offsets of points. poses: (V, 6, 6) covariances of camera_T_board.
    """

    spent: Array
    on_offsets: Array
    poses: Array


def part_posteriors(
    problem: RigProblem,
    state: RigState,
    factors: Factors,
    blocks: Sequence[Block],
    equations: Sequence[NormalEquations],
    slots: Sequence[Array],
    std: Array,
) -> tuple[PartPosterior, ...]:
    """Return what the factors of a rig's equations leave open of the views of each camera.

    blocks, equations: of the cameras alone, see `RigProblem.equations_of`. slots: of each camera the places (m_c,) of
    its coefficients in a capture's group. std: (G, m) of the coefficients, in which the factors measure them.
    """
    shared, groups = factors.shared_covariance(), factors.group_covariances()
    coupling = factors.inverse_group_root().transpose(0, 2, 1) @ factors.reduced
    cross = -np.concatenate(list(coupling)).dot(shared).reshape(coupling.shape)  # (G, g, S)
    result = []
    for camera, (block, own) in enumerate(zip(blocks, equations, strict=True)):
        captures, columns = problem.captures[camera], problem.columns(camera)
        inside = np.concatenate([np.arange(POSE), slots[camera]])
        unit = np.concatenate([np.ones((len(captures), POSE)), std[captures][:, slots[camera] - POSE]], axis=1)
        of_group = groups[np.ix_(captures, inside, inside)] * (unit[:, :, None] * unit[:, None])
        across = cross[np.ix_(captures, inside, columns)] * unit[:, :, None]
        of_shared = shared[np.ix_(columns, columns)]
        dense = own.group_products.shape[1]
        spent = np.sum(of_group * own.group_group, axis=(1, 2)) + 2 * np.sum(across * own.group_shared, axis=(1, 2))
        spent += np.sum(own.group_products * of_shared[:dense, :dense], axis=(1, 2))
        views = len(captures), -1
        offsets = np.zeros(len(captures))
        if problem.offsets:
            ids = problem.parts[camera].observations.ids
            offsets = spent_by_block(block, ids, of_shared).reshape(views)[:, 0]
        poses = _pose_covariances(problem, state, camera, of_group, across, of_shared)
        result.append(PartPosterior(spent, offsets, poses))
    return tuple(result)


def _pose_covariances(
    problem: RigProblem, state: RigState, camera: int, of_group: Array, across: Array, of_shared: Array
) -> Array:
    """Return the covariances (V, 6, 6) of camera_T_board = camera_T_rig · rig_T_board."""
    count, lens = len(of_group), len(problem.parts[camera].free)
    turn = state.camera_rotations[camera]
    by_capture = np.kron(np.eye(2), turn)
    result = by_capture @ of_group[:, :POSE, :POSE] @ by_capture.T
    if not len(problem.pose_columns(camera)):
        return np.asarray(result)
    by_camera = np.tile(np.eye(POSE), (count, 1, 1))
    by_camera[:, :3, 3:] = -so3.hat(state.translations[problem.captures[camera]] @ turn.T)
    own = slice(lens, lens + POSE)
    mixed = by_capture @ across[:, :POSE, own] @ by_camera.transpose(0, 2, 1)
    result = result + mixed + mixed.transpose(0, 2, 1)
    return np.asarray(result + by_camera @ of_shared[own, own] @ by_camera.transpose(0, 2, 1))
