"""Effects in the views of a capture, and the motion of the board between the exposures of its cameras.

The effects of calibrate/effects.py belong to a camera's views; but the board that bends is one board, whichever camera
sees it, so that the coefficients of that effect are those of the board in the capture. The motion of the board is that
of a view against the first of its capture: a shift of its centre and a rotation about it, whose coefficients move the
edge of the board by as much, in its unit.
"""

from collections.abc import Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.effects import EFFECTS, FLEX, SHARE_DOF, Effect, EffectColumns, EffectScales, radius
from camcal.calibrate.problem import POSE, State
from camcal.calibrate.rigs.problem import RigProblem
from camcal.dataclass import dataclass, replace
from camcal.geometry import rotation as so3
from camcal.targets.board import Board

SHIFT, TURN = Effect("shift", 3, of_board=True), Effect("turn", 3, of_board=True)
MOTION = (SHIFT, TURN)
KINDS = (*EFFECTS, *MOTION)
MOTION_DOF = 1.0  # as SHARE_DOF: a board held by hand is still in most captures, and moves far in some
_FLEX, _SHIFT, _TURN = KINDS.index(FLEX), KINDS.index(SHIFT), KINDS.index(TURN)


@dataclass(frozen=True, eq=False)
class CaptureEffects:
    """Which coefficients a capture has.

    kinds: the camera (None: all) and the place in KINDS of each kind of coefficient. effect: (m,) which of them each
    coefficient belongs to. slots: of each camera the coefficients (V, m_c) that the columns of its views have.
    """

    kinds: tuple[tuple[int | None, int], ...]
    effect: Array
    slots: tuple[Array, ...]

    @classmethod
    def of(cls, columns: Sequence[EffectColumns], problem: RigProblem) -> "CaptureEffects":
        """Return the coefficients for the columns of cameras, which are numbered by KINDS."""
        kinds: list[tuple[int | None, int]] = []
        effect: list[int] = []
        places: dict[tuple[int | None, int, int], list[int]] = {}  # by camera, layer or board, and kind
        slots: list[Array] = []
        for camera, of_camera in enumerate(columns):
            own = np.unique(of_camera.effect).tolist()
            size = sum(KINDS[kind].columns for kind in own)
            slots.append(np.zeros((len(problem.captures[camera]), size), np.intp))
            boards = problem.boards[camera]
            start = 0
            for kind in own:
                alike: Sequence[Array] = problem.layers[camera]
                if kind == _FLEX:
                    alike = [np.flatnonzero(boards == board) for board in range(int(boards.max(initial=0)) + 1)]
                of_whom = None if kind == _FLEX else camera
                for layer, rows in enumerate(alike):
                    if not len(rows):
                        continue
                    if (of_whom, layer, kind) not in places:
                        first = len(effect)
                        places[of_whom, layer, kind] = list(range(first, first + KINDS[kind].columns))
                        effect += [len(kinds)] * KINDS[kind].columns
                        kinds.append((of_whom, kind))
                    slots[-1][rows, start : start + KINDS[kind].columns] = places[of_whom, layer, kind]
                start += KINDS[kind].columns
        return cls(tuple(kinds), np.array(effect, np.intp), tuple(slots))

    def start(self, captures: int, sigmas: Sequence[float], side: float) -> EffectScales:
        """Return the scales to begin with; sigmas: the noise of each camera, px. side: of the board, the longer one."""
        typical = [
            (1e-4 * side) ** 2 if KINDS[kind].of_board else (0.3 * sigmas[camera or 0]) ** 2
            for camera, kind in self.kinds
        ]
        # a board that was held still between two exposures neither shifted nor turned
        owners = [("motion" if KINDS[kind] in MOTION else KINDS[kind].name, camera) for camera, kind in self.kinds]
        columns = list(dict.fromkeys(owners))
        share_of = np.array([columns.index(owner) for owner in owners], np.intp)
        share_dof = np.array([MOTION_DOF if name == "motion" else SHARE_DOF for name, _ in columns])
        return EffectScales(
            np.array(typical), np.ones((captures, len(columns))), np.array(typical), share_of, share_dof
        )

    def of_kinds(self, *effects: Effect) -> Array:
        """Return which coefficients (m,) are of some effects, of whichever camera."""
        chosen = np.array([KINDS[kind] in effects for _, kind in self.kinds], bool)
        return chosen[self.effect] if len(self.effect) else np.zeros(0, bool)


def moved_views(problem: RigProblem) -> tuple[Array, ...]:
    """Return of each camera which of its views (V,) are not the first of their capture."""
    taken = np.zeros(problem.count, bool)
    result = []
    for captures in problem.captures:
        result.append(taken[captures])
        taken[captures] = True
    return tuple(result)


def moved_poses(board: Board, state: State, coefficients: Array) -> State:
    """Return the state of a camera whose views moved by coefficients (V, 6) of motion, see `motion_columns`."""
    points = board.points()
    centre = state.rotations @ points.mean(axis=0)
    turns = so3.exp(coefficients[:, 3:] / radius(points))
    shifts = coefficients[:, :3] + centre - (turns @ centre[..., None])[..., 0]
    return replace(state, rotations=turns @ state.rotations, translations=state.translations + shifts)


def with_motion(columns: EffectColumns, motion: Array | None) -> EffectColumns:
    """Return the columns of a camera with those of motion (2, 6, V, P) behind them."""
    if motion is None:
        return columns
    effect = np.concatenate([columns.effect, np.repeat([_SHIFT, _TURN], POSE // 2)])
    return EffectColumns(np.concatenate([columns.values, motion], axis=1), effect)
