"""A board that moves smoothly before cameras that stand still: least squares where each corner has its own time.

A row of an image is taken at stamp + offset + rate · (stamp - reference) + readout · row / height, in the time of the
first camera. Shared parameters, in this order: the free lens parameters of each camera, the poses camera_T_rig (tx
ty tz rx ry rz) of all cameras but the first, the coefficients of the board's shape, the offsets and then the rates of
these cameras, the readout times of all. The groups are the spans of the board's motion rig_T_board, whose nodes are
poses.
"""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.calibrate.rigs.problem import AXES
from camcal.calibrate.timing.spline import Moments, Motion, cross
from camcal.cameras.lens import CameraModel
from camcal.cameras.observations import by_pose, linearised
from camcal.dataclass import dataclass, replace
from camcal.geometry.pose import retract
from camcal.solve.chains import WIDTH
from camcal.solve.losses import Loss
from camcal.solve.steps import Block, Jacobian, Step

OFFSET, RATE, READOUT = range(3)


@dataclass(frozen=True, eq=False)
class TimedCorners:
    """The corners (M,) that a camera saw: pixels (2, M), ids (M,) of the board's points, stamps (M,) less the
    reference, s, rows (M,), shares of the image's height, and weights (M,).

    free: the lens parameters that move. sigma: px. lens_spread: (K,) the standard deviations of the weak priors on the
    lens about the model's prior_mean, None for none.
    """

    model: CameraModel
    free: Array
    pixels: Array
    ids: Array
    stamps: Array
    rows: Array
    weights: Array
    sigma: float
    lens_spread: Array | None = None


@dataclass(frozen=True, eq=False)
class TimeState:
    """Lens parameters of N cameras, each (K,), poses camera_T_rig, times (3, N): offsets, s, rates and readouts, s, and
    shape (S,) of the board and the motion rig_T_board.
    """

    lenses: tuple[Array, ...]
    camera_rotations: Array
    camera_translations: Array
    times: Array
    shape: Array
    motion: Motion

    def of_rows(self, camera: int, stamps: Array, rows: Array) -> Array:
        """Return the times (M,) at which a camera took rows (M,) of images with stamps (M,), s."""
        offset, rate, readout = self.times[:, camera]
        return np.asarray(stamps + offset + rate * stamps + readout * rows)


@dataclass(frozen=True, eq=False)
class TimeProblem:
    """points: (C, 3) of the board but for the terms of its shape, whose displacements are basis (C, 3, S) and standard
    deviations term_std (S,). free: (3, N) bool, which times move: offsets, rates, readouts; never offset and rate of
    the first camera.
    """

    cameras: tuple[TimedCorners, ...]
    points: Array
    basis: Array
    term_std: Array
    free: Array
    spans: int
    loss: Loss | None = None

    @cached_property
    def lens_starts(self) -> tuple[int, ...]:
        """Where the free lens parameters of each camera begin among the shared parameters, and where they all end."""
        return tuple(np.cumsum([0, *(len(own.free) for own in self.cameras)]).tolist())

    @property
    def board_start(self) -> int:
        """Where the coefficients of the board's shape begin among the shared parameters."""
        return self.lens_starts[-1] + POSE * (len(self.cameras) - 1)

    @property
    def times_start(self) -> int:
        """Where the times begin among the shared parameters."""
        return self.board_start + len(self.term_std)

    def board_points(self, state: TimeState) -> Array:
        """Return the points (3, C) of the board as the state has it."""
        return np.asarray((self.points + self.basis @ state.shape).T)

    @property
    def shared(self) -> int:
        return self.times_start + int(self.free.sum())

    @property
    def groups(self) -> tuple[int, int]:
        return self.spans, WIDTH * POSE

    @cached_property
    def time_columns(self) -> Array:
        """The places (3, N) of the times among the shared parameters, -1 where they are held."""
        columns = np.full(self.free.shape, -1)
        columns[self.free] = self.times_start + np.arange(int(self.free.sum()))
        return columns

    def retract(self, state: TimeState, step: Step) -> TimeState:
        """Return the state moved by a step."""
        lenses = []
        for camera, own in enumerate(self.cameras):
            lens = state.lenses[camera].copy()
            lens[own.free] += step.shared[slice(*self.lens_starts[camera : camera + 2])]
            lenses.append(lens)
        poses = np.zeros((len(self.cameras), POSE))
        poses[1:] = step.shared[self.lens_starts[-1] : self.board_start].reshape(-1, POSE)
        rotations, translations = retract(state.camera_rotations, state.camera_translations, poses)
        times = state.times.copy()
        times[self.free] += step.shared[self.times_start :]
        shape = state.shape + step.shared[self.board_start : self.times_start]
        return TimeState(tuple(lenses), rotations, translations, times, shape, state.motion.retract(step.groups))

    def blocks(self, state: TimeState) -> list[Block] | None:
        """Return the corners and the priors, or None where a corner's time or place has no image."""
        result = []
        for camera, own in enumerate(self.cameras):
            block = self._corners(state, camera)
            if block is None:
                return None
            result.append(block)
            result += self._lens_priors(state, camera, own)
        if len(self.term_std):
            columns = np.arange(self.board_start, self.times_start)[:, None]
            slopes = (1 / self.term_std)[:, None, None]
            result.append(Block((state.shape / self.term_std)[:, None], (Jacobian(slopes, columns),)))
        return result

    def residuals(self, state: TimeState, camera: int) -> Array:
        """Return projected minus observed pixels (2, M), NaN where there is no image."""
        own = self.cameras[camera]
        points = self.seen(state, camera, state.of_rows(camera, own.stamps, own.rows), own.ids)
        return np.asarray(own.model.project(state.lenses[camera], points.T).pixels.T - own.pixels)

    def seen(self, state: TimeState, camera: int, times: Array, ids: Array) -> Array:
        """Return points ids (M,) of the board at times (M,) in the frame of a camera (3, M)."""
        return self._points(state, camera, times, ids)[0]

    def names(self, cameras: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the parameters of lenses and poses, as RigProblem has them."""
        lenses = [
            f"{name}.{own.model.parameter_names[index]}"
            for name, own in zip(cameras, self.cameras, strict=True)
            for index in own.free
        ]
        return (*lenses, *(f"{name}_T_{cameras[0]}.{axis}" for name in cameras[1:] for axis in AXES))

    def _points(self, state: TimeState, camera: int, times: Array, ids: Array) -> tuple[Array, Moments, Array]:
        """Return points ids (M,) of the board at times (M,) in the camera frame, the moments, and the points along the
        rig's axes from the board's origin.
        """
        moments = state.motion.at(times)
        turned = moments.turned(self.board_points(state)[:, ids])
        moved = state.camera_rotations[camera] @ (turned + moments.translations)
        return moved + state.camera_translations[camera][:, None], moments, turned

    def _corners(self, state: TimeState, camera: int) -> Block | None:
        own = self.cameras[camera]
        times = state.of_rows(camera, own.stamps, own.rows)
        if not state.motion.knots.contain(times).all():
            return None
        rows, groups, weights = _by_span(state.motion.knots.places(times)[0], own.weights)
        points, moments, turned = self._points(state, camera, times[rows], own.ids[rows])
        seen = linearised(own.model, state.lenses[camera], points, own.pixels[:, rows], within_domain=False)
        if np.any((weights > 0) & ~seen.valid):
            return None
        in_rig = np.stack([state.camera_rotations[camera].T @ row for row in seen.by_point])
        by_time = np.sum(in_rig * (moments.velocities + cross(moments.turning, turned)), axis=1)  # (2, M)
        lens = np.arange(*self.lens_starts[camera : camera + 2])
        shared = [Jacobian(seen.by_lens[:, own.free].transpose(2, 0, 1), lens)]
        if camera:
            start = self.lens_starts[-1] + POSE * (camera - 1)
            pose = by_pose(seen.by_point, points - state.camera_translations[camera][:, None])
            shared.append(Jacobian(pose.transpose(2, 0, 1), np.arange(start, start + POSE)))
        if len(self.term_std):
            axes = np.stack([moments.turned_back(row) for row in in_rig])
            terms = np.einsum("dim,mis->dsm", axes, self.basis[own.ids[rows]], optimize=True)
            shared.append(Jacobian(terms.transpose(2, 0, 1), np.arange(self.board_start, self.times_start)))
        free = self.free[:, camera]
        if free.any():
            parts = np.stack([by_time, by_time * own.stamps[rows], by_time * own.rows[rows]])[free]
            shared.append(Jacobian(parts.transpose(2, 1, 0), self.time_columns[free, camera]))
        return Block(
            seen.residuals.T,
            tuple(shared),
            moments.by_nodes(in_rig, turned).transpose(2, 0, 1),
            rows_per_group=len(rows) // len(groups),
            groups=groups,
            weights=weights / own.sigma**2,
            loss=self.loss,
        )

    def _lens_priors(self, state: TimeState, camera: int, own: TimedCorners) -> list[Block]:
        if own.lens_spread is None or not len(own.free):
            return []
        spread = own.lens_spread[own.free]
        apart = (state.lenses[camera] - own.model.prior_mean)[own.free] / spread
        columns = np.arange(*self.lens_starts[camera : camera + 2])[:, None]
        return [Block(apart[:, None], (Jacobian((1 / spread)[:, None, None], columns),))]


def _by_span(spans: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return which corners (R,) are the rows of a block, as many for each of the spans that have some, these spans, and
    the weights of the rows, 0 for those that fill up.
    """
    order = np.argsort(spans, kind="stable")
    used, counts = np.unique(spans, return_counts=True)
    length = int(counts.max())
    places = (np.cumsum(counts) - counts)[:, None] + np.arange(length)
    filling = np.arange(length) >= counts[:, None]
    rows = order[np.where(filling, 0, places).ravel()]
    return rows, used, np.where(filling.ravel(), 0.0, weights[rows])


def with_weights(problem: TimeProblem, weights: Sequence[Array], sigmas: Sequence[float]) -> TimeProblem:
    """Return the problem with other weights and noise of the corners of its cameras."""
    cameras = [
        replace(own, weights=weight, sigma=sigma)
        for own, weight, sigma in zip(problem.cameras, weights, sigmas, strict=True)
    ]
    return replace(problem, cameras=tuple(cameras))
