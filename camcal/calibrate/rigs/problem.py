"""Several cameras and a board in many captures as a least-squares problem: the only place that knows its layout.

Shared parameters, in this order: the free lens parameters of each camera, the poses camera_T_rig (tx ty tz rx ry rz) of
all cameras but the first, the coefficients of the board's shape, the offsets of its points. Each capture's pose
rig_T_board is a group of six, followed by the coefficients of effects in its views. The rig's frame is the first
camera's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE, BoardProblem, Derivatives, State
from camcal.geometry import rotation as so3
from camcal.geometry.pose import retract
from camcal.solve.least_squares import assemble
from camcal.solve.steps import Block, Jacobian, NormalEquations, Step
from camcal.targets.board import Board

AXES = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True, eq=False)
class RigState:
    """Lens parameters of N cameras, each (K,), their poses camera_T_rig as rotations (N, 3, 3) and translations (N, 3),
    those of G captures, rig_T_board, shape (S,) and offsets (C, 3) of the board's points.
    """

    lenses: tuple[Array, ...]
    camera_rotations: Array
    camera_translations: Array
    rotations: Array
    translations: Array
    shape: Array
    offsets: Array

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
    its views belong to. priors_of_lenses: by the places of cameras. poses_held: whether the cameras do not move.
    """

    parts: tuple[BoardProblem, ...]
    captures: tuple[Array, ...]
    count: int
    priors_of_lenses: dict[int, LensPrior] = field(default_factory=dict)
    poses_held: bool = False

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
    def board_start(self) -> int:
        """Where the terms of the board's shape begin among the shared parameters."""
        return self.lens_starts[-1] + (0 if self.poses_held else POSE * (len(self.parts) - 1))

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

    @property
    def _moving(self) -> int:
        """The first camera whose pose is estimated."""
        return len(self.parts) if self.poses_held else 1

    def pose_columns(self, camera: int) -> Array:
        """Return the places of a camera's pose among the shared parameters; none of the first camera's."""
        if not camera or self.poses_held:
            return np.zeros(0, np.intp)
        first = self.lens_starts[-1] + POSE * (camera - 1)
        return np.arange(first, first + POSE)

    def columns(self, camera: int) -> Array:
        """Return the places of what a camera's views depend on: its lens, its pose, the board's terms and offsets."""
        lens = np.arange(*self.lens_starts[camera : camera + 2])
        return np.concatenate([lens, self.pose_columns(camera), np.arange(self.board_start, self.shared)])

    def names(self, cameras: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the parameters of lenses and poses, such as left.fx and right_T_left.tx."""
        lenses = [
            f"{name}.{part.model.parameter_names[index]}"
            for name, part in zip(cameras, self.parts, strict=True)
            for index in part.free
        ]
        return (*lenses, *(f"{name}_T_{cameras[0]}.{axis}" for name in cameras[1:] for axis in AXES))

    def of_camera(self, state: RigState, camera: int) -> State:
        """Return the state of one camera's part: its lens and the poses camera_T_board of its views."""
        captures, rotation = self.captures[camera], state.camera_rotations[camera]
        translations = state.translations[captures] @ rotation.T + state.camera_translations[camera]
        return State(
            state.lenses[camera], rotation @ state.rotations[captures], translations, state.shape, state.offsets
        )

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
            poses[1:] = step.shared[self.lens_starts[-1] : self.board_start].reshape(-1, POSE)
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
        )

    def blocks(self, state: RigState) -> list[Block] | None:
        """Return the observations and the priors, or None where a point has no image (see BoardProblem.blocks)."""
        result = []
        for camera, part in enumerate(self.parts):
            own = self.of_camera(state, camera)
            blocks = replace(part, lens_spread=None, term_std=None, offset_std=None).blocks(own)
            if blocks is None:
                return None
            result.append(self._placed(blocks[0], state, camera))
        return result + self.priors(state)

    def observed(self, state: RigState) -> list[Block]:
        """Return the observations, by the lenses' formulas beyond their domains as well."""
        own = [self.of_camera(state, camera) for camera in range(len(self.parts))]
        blocks = [part.data(each, part.derivatives(each)) for part, each in zip(self.parts, own, strict=True)]
        return [self._placed(block, state, camera) for camera, block in enumerate(blocks)]

    def _placed(self, block: Block, state: RigState, camera: int) -> Block:
        """Return the block of a camera's views as one of captures, by the shared parameters of the rig."""
        columns, block = self.columns(camera), self.in_rig(block, state, camera)
        shared = tuple(Jacobian(each.values, columns[each.columns]) for each in block.shared)
        return replace(block, shared=shared, groups=self.captures[camera])

    def in_rig(self, block: Block, state: RigState, camera: int) -> Block:
        """Return the block of a camera's views by the poses of camera and capture in place of camera_T_board.

        Its shared parameters are numbered as in `columns`; its groups are the camera's views.
        """
        assert block.group is not None
        by_pose = block.group[..., :POSE].transpose(1, 2, 0)  # (2, 6, M)
        turn = state.camera_rotations[camera]
        # camera_T_board = camera_T_rig rig_T_board; see geometry.pose.compose_jacobians
        by_capture = np.concatenate(
            [np.einsum("dim,ij->djm", by_pose[:, :3], turn), np.einsum("dim,ij->djm", by_pose[:, 3:], turn)], axis=1
        )
        group = np.concatenate([by_capture, block.group[..., POSE:].transpose(1, 2, 0)], axis=1).transpose(2, 0, 1)
        lens, *others = block.shared
        if not len(self.pose_columns(camera)):
            return replace(block, group=group)
        arms = so3.hat(state.translations[self.captures[camera]] @ turn.T)  # (V, 3, 3)
        by_camera = by_pose.copy()
        views = by_pose[:, :3].reshape(2, 3, len(arms), -1)
        by_camera[:, 3:] -= np.einsum("divp,vij->djvp", views, arms).reshape(2, 3, -1)
        count = len(self.parts[camera].free)
        pose = Jacobian(by_camera.transpose(2, 0, 1), np.arange(count, count + POSE))
        behind = tuple(Jacobian(each.values, each.columns + POSE) for each in others)
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

        slots: of each camera the places (m,) of its effects among the `size` parameters of a capture.
        """
        total = assemble([], self.shared, self.count, size)
        groups = np.zeros((self.count, size, size))
        products = np.zeros((self.count, self.dense, self.dense))
        for camera, (own, places) in enumerate(zip(equations, slots, strict=True)):
            captures, columns = self.captures[camera], self.columns(camera)
            inside = np.concatenate([np.arange(POSE), places])
            seen = ~_untouched(own)
            groups[np.ix_(captures, inside, inside)] += own.group_group * seen[:, None, None]
            total.gradient.groups[np.ix_(captures, inside)] += own.gradient.groups
            total.group_shared[np.ix_(captures, inside, columns)] += own.group_shared
            total.group_gradients[np.ix_(captures, columns)] += own.group_gradients
            total.gradient.shared[columns] += own.gradient.shared
            total.shared_shared[np.ix_(columns, columns)] += own.shared_shared
            dense = columns[: own.group_products.shape[1]]
            products[np.ix_(captures, dense, dense)] += own.group_products
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
        return result + self.parts[0].board_priors(self.of_camera(state, 0), self.board_start)

    def change(self, before: RigState, after: RigState) -> Array:
        """Return by how much free lens parameters and camera poses have changed, in the order of the shared ones."""
        lenses = [
            (new - old)[part.free] for old, new, part in zip(before.lenses, after.lenses, self.parts, strict=True)
        ]
        turns = so3.log(after.camera_rotations @ before.camera_rotations.transpose(0, 2, 1))
        apart = after.camera_translations - before.camera_translations
        poses = np.concatenate([apart, turns], axis=1)[self._moving :]
        return np.concatenate([*lenses, poses.ravel()])

    def shared_values(self, state: RigState) -> Array:
        """Return the shared parameters (D,) before the offsets of a state; poses as their steps from the identity."""
        lenses = [state.lenses[camera][part.free] for camera, part in enumerate(self.parts)]
        poses = np.concatenate([state.camera_translations, so3.log(state.camera_rotations)], axis=1)[self._moving :]
        return np.concatenate([*lenses, poses.ravel(), state.shape])

    def prior_precision(self) -> Array:
        """Return the precision (D, D) of the priors of the same parameters."""
        result = np.zeros((self.dense, self.dense))
        for camera, part in enumerate(self.parts):
            own = slice(*self.lens_starts[camera : camera + 2])
            known, precision = self.priors_of_lenses.get(camera), part.prior_precision()
            count = len(part.free)
            result[own, own] = precision[:count, :count] if known is None else known.root.T @ known.root
            result[self.board_start :, self.board_start :] = precision[count:, count:]
        return result

    def captures_only(self, state: RigState) -> "tuple[RigProblem, RigState]":
        """Return the problem and state of the captures' poses alone, everything else held."""
        bare = [part.poses_only(self.of_camera(state, camera))[0] for camera, part in enumerate(self.parts)]
        return RigProblem(tuple(bare), self.captures, self.count, poses_held=True), replace(
            state, shape=np.zeros(0), offsets=0 * state.offsets
        )


def _untouched(equations: NormalEquations) -> Array:
    """Return the groups (V,) that no residual depends on, whose matrix is the identity by convention."""
    identity = np.eye(equations.group_group.shape[-1])
    return np.asarray((equations.group_group == identity).all(axis=(1, 2)))
