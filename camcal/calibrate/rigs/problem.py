"""Several cameras and bodies in many captures as a least-squares problem: the only place that knows its layout.

A body is a board, or several that are joined; its frame is that of its first board. Shared parameters, in this order:
the free lens parameters of each camera, the poses camera_T_rig (tx ty tz rx ry rz) of all cameras but the first, those
body_T_board of boards that are joined to others, the coefficients of the boards' shape, the offsets of their points.
The pose rig_T_body of each body in each capture is a group of six, followed by the coefficients of effects in its
views. The rig's frame is the first camera's.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE, BoardProblem, Derivatives, State
from camcal.calibrate.rigs.measured import BoardPoses, Measured, measured_blocks
from camcal.dataclass import dataclass, field, replace
from camcal.geometry import rotation as so3
from camcal.geometry.pose import retract
from camcal.solve.least_squares import assemble, part_of
from camcal.solve.steps import Block, Jacobian, NormalEquations, Step
from camcal.targets.board import Board

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True, eq=False)
class RigState:
    """Lens parameters of N cameras, each (K,), their poses camera_T_rig as rotations (N, 3, 3) and translations (N, 3),
    those of G captures of a body, rig_T_body, shape (S,) and offsets (C, 3) of the boards' points. boards: their poses
    on bodies.
    """

    lenses: tuple[Array, ...]
    camera_rotations: Array
    camera_translations: Array
    rotations: Array
    translations: Array
    shape: Array
    offsets: Array
    boards: BoardPoses = field(default_factory=BoardPoses.one)

    def take(self, captures: Array) -> "RigState":
        """Return the state of some of the captures."""
        return replace(self, rotations=self.rotations[captures], translations=self.translations[captures])


@dataclass(frozen=True, eq=False)
class LensPrior:
    """The mean (K,) of a camera's free lens parameters, and the root (K, K) of their precision R, precision RᵀR."""

    mean: Array
    root: Array


@dataclass(frozen=True, eq=False)
class RigProblem:
    """parts: of each camera, its views in the order of `captures`: (V,) of each camera, which of the `count` captures
    of a body its views belong to. priors_of_lenses: by the places of cameras. poses_held: whether cameras do not move.
    bodies: (V,) of each camera, the places of the boards that its views are of; none where there is one board.
    attached: the boards whose poses on their bodies are solved for. measured: what is known of boards beforehand.
    """

    parts: tuple[BoardProblem, ...]
    captures: tuple[Array, ...]
    count: int
    priors_of_lenses: dict[int, LensPrior] = field(default_factory=dict)
    poses_held: bool = False
    bodies: tuple[Array, ...] = ()
    attached: tuple[int, ...] = ()
    measured: Measured = field(default_factory=Measured)

    @property
    def board(self) -> Board:
        return self.parts[0].board

    @property
    def offsets(self) -> bool:
        """Whether the offsets of the board's points are solved for together with everything else."""
        return self.parts[0].offsets

    @property
    def terms(self) -> int:
        """The number of the terms of the board's shape."""
        return len(self.parts[0].terms)

    @cached_property
    def lens_starts(self) -> tuple[int, ...]:
        """Where the free lens parameters of each camera begin among the shared parameters, and where they all end."""
        return tuple(np.cumsum([0, *(len(part.free) for part in self.parts)]).tolist())

    @property
    def attached_start(self) -> int:
        """Where the poses of boards on their bodies begin among the shared parameters."""
        return self.lens_starts[-1] + (0 if self.poses_held else POSE * (len(self.parts) - 1))

    @property
    def board_start(self) -> int:
        """Where the terms of the board's shape begin among the shared parameters."""
        return self.attached_start + POSE * len(self.attached)

    @property
    def boards(self) -> tuple[Array, ...]:
        """Of each camera the places of the boards (V,) that its views are of."""
        return self.bodies or tuple(np.zeros(len(captures), np.intp) for captures in self.captures)

    @cached_property
    def layers(self) -> tuple[tuple[Array, ...], ...]:
        """Of each camera its views in parts, in each of which no capture of a body occurs twice."""
        result = []
        for captures in self.captures:
            order = np.argsort(captures, kind="stable")
            ranked = captures[order]
            rank = np.empty(len(order), np.intp)
            rank[order] = np.arange(len(order)) - np.searchsorted(ranked, ranked)
            result.append(tuple(np.flatnonzero(rank == layer) for layer in range(int(rank.max(initial=-1)) + 1)))
        return tuple(result)

    @property
    def dense(self) -> int:
        """The number of shared parameters before the offsets."""
        return self.board_start + self.terms

    @property
    def shared(self) -> int:
        return self.dense + (3 * self.board.count if self.offsets else 0)

    @property
    def groups(self) -> tuple[int, int]:
        return self.count, POSE

    def pose_columns(self, camera: int) -> Array:
        """Return the places of a camera's pose among the shared parameters; none of the first camera's."""
        if not camera or self.poses_held:
            return np.zeros(0, np.intp)
        first = self.lens_starts[-1] + POSE * (camera - 1)
        return np.arange(first, first + POSE)

    def columns(self, camera: int) -> Array:
        """Return the places of what a camera's views depend on: its lens, its pose, those of the boards on their
        bodies, the boards' terms and offsets.
        """
        lens = np.arange(*self.lens_starts[camera : camera + 2])
        return np.concatenate([lens, self.pose_columns(camera), np.arange(self.attached_start, self.shared)])

    def names(self, cameras: Sequence[str], boards: Sequence[str] = ()) -> tuple[str, ...]:
        """Return the names of the parameters of lenses and poses, such as left.fx and right_T_left.tx.

        boards: the names of the poses of boards on their bodies, in the order of `attached`.
        """
        lenses = [
            f"{name}.{part.model.parameter_names[index]}"
            for name, part in zip(cameras, self.parts, strict=True)
            for index in part.free
        ]
        poses = [*(f"{name}_T_{cameras[0]}" for name in cameras[1:]), *boards]
        return (*lenses, *(f"{name}.{axis}" for name in poses for axis in AXES))

    def of_camera(self, state: RigState, camera: int) -> State:
        """Return the state of one camera's part: its lens and the poses camera_T_board of its views."""
        rotation, (rotations, translations) = state.camera_rotations[camera], self._on_rig(state, camera)
        translations = translations @ rotation.T + state.camera_translations[camera]
        return State(state.lenses[camera], rotation @ rotations, translations, state.shape, state.offsets)

    def _on_rig(self, state: RigState, camera: int) -> tuple[Array, Array]:
        """Return the poses rig_T_board, rotations (V, 3, 3) and translations (V, 3), of a camera's views."""
        captures = self.captures[camera]
        rotations, translations = state.rotations[captures], state.translations[captures]
        if not self.bodies:
            return rotations, translations
        boards = self.bodies[camera]
        moved = (rotations @ state.boards.translations[boards][..., None])[..., 0] + translations
        return rotations @ state.boards.rotations[boards], moved

    def pose_jacobians(self, state: RigState, camera: int) -> tuple[Array, Array]:
        """Return the derivatives of the steps of camera_T_board of a camera's views: by those of their captures
        (V, 6, 6), and by those of the camera and of the boards on their bodies (V, 6, n); see
        geometry.pose.compose_jacobians.
        """
        turn = state.camera_rotations[camera]
        captures, (_, translations) = self.captures[camera], self._on_rig(state, camera)
        count = len(captures)
        by_capture = np.zeros((count, POSE, POSE))
        by_capture[:, :3, :3] = by_capture[:, 3:, 3:] = turn
        if self.bodies:
            by_capture[:, :3, 3:] = -turn @ so3.hat(translations - state.translations[captures])
        shared = []
        if len(self.pose_columns(camera)):
            by_camera = np.tile(np.eye(POSE), (count, 1, 1))
            by_camera[:, :3, 3:] = -so3.hat(translations @ turn.T)
            shared.append(by_camera)
        for board in self.attached:
            by_board = np.zeros((count, POSE, POSE))
            rows = self.bodies[camera] == board
            by_board[rows, :3, :3] = by_board[rows, 3:, 3:] = turn @ state.rotations[captures[rows]]
            shared.append(by_board)
        return by_capture, np.concatenate(shared, axis=2) if shared else np.zeros((count, POSE, 0))

    def with_parts(self, parts: Sequence[BoardProblem]) -> "RigProblem":
        return replace(self, parts=tuple(parts))

    def retract(self, state: RigState, step: Step) -> RigState:
        """Return the state moved by a step."""
        lenses = []
        for camera, part in enumerate(self.parts):
            lens = state.lenses[camera].copy()
            lens[part.free] += step.shared[slice(*self.lens_starts[camera : camera + 2])]
            lenses.append(lens)
        poses = np.zeros((len(self.parts), POSE))
        if not self.poses_held:
            poses[1:] = step.shared[self.lens_starts[-1] : self.attached_start].reshape(-1, POSE)
        camera_rotations, camera_translations = retract(state.camera_rotations, state.camera_translations, poses)
        rotations, translations = retract(state.rotations, state.translations, step.groups[:, :POSE])
        shape = state.shape + step.shared[self.board_start : self.dense]
        offsets = state.offsets + step.shared[self.dense :].reshape(-1, 3) if self.offsets else state.offsets
        return RigState(
            tuple(lenses),
            camera_rotations,
            camera_translations,
            rotations=rotations,
            translations=translations,
            shape=shape,
            offsets=offsets,
            boards=state.boards.moved(self.attached, step.shared[self.attached_start : self.board_start]),
        )

    def blocks(self, state: RigState) -> list[Block] | None:
        """Return the observations and the priors, or None where a point has no image (see BoardProblem.blocks)."""
        result = []
        for camera, part in enumerate(self.parts):
            own = self.of_camera(state, camera)
            blocks = replace(part, lens_spread=None, term_std=None, offset_std=None).blocks(own)
            if blocks is None:
                return None
            result += self._place_blocks(blocks[0], state, camera)
        return result + self.priors(state)

    def observed(self, state: RigState) -> list[Block]:
        """Return the observations, by the lenses' formulas beyond their domains as well."""
        own = [self.of_camera(state, camera) for camera in range(len(self.parts))]
        blocks = [part.data(each, part.derivatives(each)) for part, each in zip(self.parts, own, strict=True)]
        return [own for camera, block in enumerate(blocks) for own in self._place_blocks(block, state, camera)]

    def _place_blocks(self, block: Block, state: RigState, camera: int) -> list[Block]:
        """Return the block of a camera's views as blocks of captures, by the shared parameters of the rig."""
        columns, block = self.columns(camera), self.in_rig(block, state, camera)
        shared = tuple(Jacobian(each.values, columns[each.columns]) for each in block.shared)
        block, captures = replace(block, shared=shared), self.captures[camera]
        if len(self.layers[camera]) == 1:
            return [replace(block, groups=captures)]
        return [replace(part_of(block, rows), groups=captures[rows]) for rows in self.layers[camera]]

    def in_rig(self, block: Block, state: RigState, camera: int) -> Block:
        """Return the block of a camera's views by the poses of camera and capture in place of camera_T_board.

        Its shared parameters are numbered as in `columns`; its groups are the camera's views.
        """
        assert block.group is not None
        by_pose = block.group[..., :POSE].transpose(1, 2, 0)  # (2, 6, M)
        turn, (by_capture, by_shared) = state.camera_rotations[camera], self.pose_jacobians(state, camera)
        views = by_pose.reshape(2, POSE, len(by_capture), -1)
        group = np.concatenate(
            [np.einsum("dim,ij->djm", by_pose[:, :3], turn), np.einsum("dim,ij->djm", by_pose[:, 3:], turn)], axis=1
        )
        if self.bodies:
            arms = np.einsum("divp,vij->djvp", views[:, :3], by_capture[:, :3, 3:])
            group[:, 3:] += arms.reshape(2, 3, -1)
        group = np.concatenate([group, block.group[..., POSE:].transpose(1, 2, 0)], axis=1).transpose(2, 0, 1)
        lens, *others = block.shared
        size = by_shared.shape[2]
        if not size:
            return replace(block, group=group)
        values = np.zeros((2, size, by_pose.shape[2]))
        of_boards = values.reshape(2, size, *views.shape[2:])
        start = len(self.pose_columns(camera))
        if start:
            values[:, :POSE] = by_pose
            arms = np.einsum("divp,vij->djvp", views[:, :3], by_shared[:, :3, 3:POSE])
            values[:, 3:POSE] += arms.reshape(2, 3, -1)
        for first, board in zip(range(start, size, POSE), self.attached, strict=True):
            rows = self.bodies[camera] == board
            own = by_shared[rows, :, first : first + POSE]
            of_boards[:, first : first + POSE, rows] = np.einsum("divp,vij->djvp", views[:, :, rows], own)
        count = len(self.parts[camera].free)
        pose = Jacobian(values.transpose(2, 0, 1), np.arange(count, count + size))
        behind = tuple(Jacobian(each.values, each.columns + size) for each in others)
        return replace(block, group=group, shared=(lens, pose, *behind))

    def equations_of(
        self, state: RigState, camera: int, own: State, derivatives: Derivatives, effects: Array | None
    ) -> tuple[Block, NormalEquations]:
        """Return a camera's block and its equations alone: groups are its views, shared parameters as in `columns`.

        own: its state, see `of_camera`. effects: (2, m, V, P) columns.
        """
        part = self.parts[camera]
        block = self.in_rig(part.data(own, derivatives, effects), state, camera)
        size = POSE + (0 if effects is None else effects.shape[1])
        return block, assemble([block], len(self.columns(camera)), len(self.captures[camera]), size)

    def joined(self, equations: Sequence[NormalEquations], slots: Sequence[Array], size: int) -> NormalEquations:
        """Return the equations of all captures from those of the cameras, without priors.

        slots: of each camera the places (V, m) of the effects in its views among the `size` parameters of a capture.
        """
        total = assemble([], self.shared, self.count, size)
        groups = np.zeros((self.count, size, size))
        products = np.zeros((self.count, self.dense, self.dense))
        for camera, (own, places) in enumerate(zip(equations, slots, strict=True)):
            columns, seen = self.columns(camera), ~_untouched(own)
            dense = columns[: own.group_products.shape[1]]
            inside = np.concatenate([np.tile(np.arange(POSE), (len(places), 1)), places], axis=1)
            total.gradient.shared[columns] += own.gradient.shared
            total.shared_shared[np.ix_(columns, columns)] += own.shared_shared
            for rows in self.layers[camera]:
                where = self.captures[camera][rows]
                first, second = where[:, None], inside[rows]
                groups[first[..., None], second[:, :, None], second[:, None]] += (
                    own.group_group[rows] * seen[rows, None, None]
                )
                total.gradient.groups[first, second] += own.gradient.groups[rows]
                total.group_shared[first[..., None], second[:, :, None], columns] += own.group_shared[rows]
                total.group_gradients[first, columns] += own.group_gradients[rows]
                products[first[..., None], dense[:, None], dense] += own.group_products[rows]
        groups[~groups.any(axis=(1, 2))] = np.eye(size)
        cost = sum(own.cost for own in equations)
        return replace(total, cost=cost, group_group=groups, group_products=products)

    def priors(self, state: RigState) -> list[Block]:
        """Return the priors of the lenses and of the board."""
        result = []
        for camera, part in enumerate(self.parts):
            start, own = self.lens_starts[camera], self.of_camera(state, camera)
            known = self.priors_of_lenses.get(camera)
            if known is None:
                result += part.lens_priors(own, start)
                continue
            apart = known.root @ (state.lenses[camera][part.free] - known.mean)
            columns = np.arange(start, start + len(part.free))
            result.append(Block(apart[None], (Jacobian(known.root[None], columns),)))
        result += self.parts[0].board_priors(self.of_camera(state, 0), self.board_start)
        return result + self.measured_blocks(state)

    def measured_blocks(self, state: RigState) -> list[Block]:
        """Return what is known of the boards beforehand."""
        if not self.measured:
            return []
        part = self.parts[0]
        starts = {board: self.attached_start + POSE * place for place, board in enumerate(self.attached)}
        points = part.board_points(self.of_camera(state, 0))
        offsets = self.dense if self.offsets else None
        return measured_blocks(self.measured, state.boards, starts, points, part.shape_basis, self.board_start, offsets)

    def change(self, before: RigState, after: RigState) -> Array:
        """Return by how much free lens parameters and poses have changed, in the order of the shared ones."""
        lenses = [
            (new - old)[part.free] for old, new, part in zip(before.lenses, after.lenses, self.parts, strict=True)
        ]
        was, now = (BoardPoses(each.camera_rotations, each.camera_translations) for each in (before, after))
        cameras = was.steps_to(now, range(len(self.parts) if self.poses_held else 1, len(self.parts)))
        return np.concatenate([*lenses, cameras, before.boards.steps_to(after.boards, self.attached)])

    def shared_values(self, state: RigState) -> Array:
        """Return the shared parameters (D,) before the offsets of a state; poses as their steps from the identity."""
        none = BoardPoses.one(len(self.parts))
        origin = replace(
            state,
            lenses=tuple(0 * lens for lens in state.lenses),
            camera_rotations=none.rotations,
            camera_translations=none.translations,
            boards=BoardPoses.one(len(state.boards.translations)),
        )
        return np.concatenate([self.change(origin, state), state.shape])

    def prior_precision(self, state: RigState) -> Array:
        """Return the precision (D, D) of the priors of the same parameters."""
        result = np.zeros((self.dense, self.dense))
        for camera, part in enumerate(self.parts):
            own = slice(*self.lens_starts[camera : camera + 2])
            known, precision = self.priors_of_lenses.get(camera), part.prior_precision(self.of_camera(state, camera))
            count = len(part.free)
            result[own, own] = precision[:count, :count] if known is None else known.root.T @ known.root
            result[self.board_start :, self.board_start :] = precision[count:, count:]
        measured = assemble(self.measured_blocks(state), self.shared, 0, POSE)
        return result + measured.shared_shared[: self.dense, : self.dense]

    def captures_only(self, state: RigState) -> "tuple[RigProblem, RigState]":
        """Return the problem and state of the captures' poses alone, everything else held."""
        bare = [part.poses_only(self.of_camera(state, camera))[0] for camera, part in enumerate(self.parts)]
        held = RigProblem(tuple(bare), self.captures, self.count, poses_held=True, bodies=self.bodies)
        return held, replace(state, shape=np.zeros(0), offsets=0 * state.offsets)


def _untouched(equations: NormalEquations) -> Array:
    """Return the groups (V,) that no residual depends on, whose matrix is the identity by convention."""
    identity = np.eye(equations.group_group.shape[-1])
    return np.asarray((equations.group_group == identity).all(axis=(1, 2)))
