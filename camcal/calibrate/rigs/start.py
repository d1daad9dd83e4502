"""Where the estimate of a rig starts: lenses of the cameras alone, and poses as links place them."""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.intrinsics import Solved
from camcal.calibrate.rigs.links import CameraPoses, motions
from camcal.calibrate.rigs.measured import Measured
from camcal.calibrate.rigs.placement import PlacedRig
from camcal.calibrate.rigs.problem import LensPrior, RigProblem, RigState
from camcal.calibrate.shape import first_scales, with_priors
from camcal.dataclass import dataclass, replace
from camcal.geometry import rotation as so3
from camcal.targets.board import SCALE, terms_of


@dataclass(frozen=True, eq=False)
class RigStart:
    """A camera to begin with: its solution, and the row of captures (V,) of each of its views."""

    solved: Solved
    captures: Array

    @property
    def poses(self) -> CameraPoses:
        """The poses of its views."""
        state = self.solved.fit.state
        return CameraPoses(self.captures, state.rotations, state.translations)


def start_rig(
    starts: Sequence[RigStart],
    placed: PlacedRig,
    groups: tuple[Array, Array, int],
    priors: dict[int, LensPrior],
    measured: Measured,
) -> tuple[RigProblem, RigState, tuple[Array, ...]]:
    """Return problem and state with every view of a symmetric board numbered alike within its capture, and the
    symmetries by which views were turned for that.
    """
    fits = [start.solved.fit for start in starts]
    board, (group_of, board_of, count) = fits[0].problem.board, groups
    several = len(board.members) > 1
    symmetries = np.stack(board.symmetries())
    turns, shifts = motions(board)
    largest = int(np.argmax([len(start.captures) for start in starts]))
    shape, offsets = fits[largest].state.shape, fits[largest].state.offsets
    scales = terms_of(board, (SCALE,)) if measured.distances else ()
    terms, shape = (*fits[0].problem.terms, *scales), np.concatenate([shape, np.zeros(len(scales))])
    rotations, translations = np.zeros((count, 3, 3)), np.zeros((count, 3))
    known = np.zeros(count, bool)
    parts, turned = [], []
    for camera, (start, fit) in enumerate(zip(starts, fits, strict=True)):
        captures, on_board = group_of[start.captures], board_of[start.captures]
        back, place = placed.cameras.rotations[camera].T, placed.cameras.translations[camera]
        candidates = back @ (fit.state.rotations[:, None] @ turns)
        moved = fit.state.translations[:, None] + np.einsum("vij,sj->vsi", fit.state.rotations, shifts) - place
        moved = moved @ back.T
        if several:  # poses of the bodies, not of the boards on them
            candidates = candidates @ placed.boards.rotations[on_board].transpose(0, 2, 1)[:, None]
            moved = moved - np.einsum("vsij,vj->vsi", candidates, placed.boards.translations[on_board])
        first = ~known[captures]
        away = so3.log(rotations[captures].transpose(0, 2, 1)[:, None] @ candidates)
        chosen = np.argmin(np.linalg.norm(away, axis=2), axis=1)
        # alone, each camera numbers its views alike: most others say how
        usual = np.argmax(np.bincount(chosen[~first], minlength=len(turns))) if not first.all() else 0
        chosen = np.where(first, usual, chosen)
        rows = np.arange(len(chosen))
        new = captures[first]
        rotations[new], translations[new] = candidates[rows, chosen][first], moved[rows, chosen][first]
        known[new] = True
        observations = fit.problem.observations
        ids = np.take_along_axis(symmetries[chosen], observations.ids, axis=1)
        weights = np.where(observations.present, 1.0, 0.0)
        table = replace(observations, ids=ids, weights=weights)
        parts.append(replace(fit.problem, observations=table, noise=None, offsets=False, loss=None, terms=terms))
        turned.append(chosen)
    lenses = tuple(fit.state.parameters for fit in fits)
    cameras = range(len(starts))
    state = RigState(
        lenses,
        np.stack([placed.cameras.rotations[camera] for camera in cameras]),
        np.stack([placed.cameras.translations[camera] for camera in cameras]),
        rotations=rotations,
        translations=translations,
        shape=shape,
        offsets=offsets,
        boards=placed.boards,
    )
    problem = RigProblem(
        tuple(with_priors(part, first_scales()) for part in parts) if scales else tuple(parts),
        tuple(group_of[start.captures] for start in starts),
        count,
        priors,
        bodies=tuple(board_of[start.captures] for start in starts) if several else (),
        attached=placed.attached,
        measured=measured,
    )
    return problem, state, tuple(turned)
