"""What is known of boards beforehand, beside their drawings: where one stands against another, distances of points."""

from collections.abc import Mapping, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.problem import POSE
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose, retract
from camcal.messages import Message
from camcal.solve.steps import Block, Jacobian

_CONTRADICTED = 30.0  # of χ² of six coordinates: one in 25 000 relations that are right
_FAR = 4.5  # standard deviations of a distance
_SAID = 1e-6  # share of a variance that is left by other things, from which on they say something


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Poses body_T_board of boards on their bodies: rotations (B, 3, 3), translations (B, 3)."""

    rotations: Array
    translations: Array

    @classmethod
    def one(cls, count: int = 1) -> "BoardPoses":
        """Return boards that are each a body of their own."""
        return cls(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))

    def moved(self, boards: Sequence[int], steps: Array) -> "BoardPoses":
        """Return the poses with those of some boards moved by steps (6 n,)."""
        if not boards:
            return self
        rotations, translations, chosen = self.rotations.copy(), self.translations.copy(), list(boards)
        rotations[chosen], translations[chosen] = retract(
            rotations[chosen], translations[chosen], steps.reshape(-1, POSE)
        )
        return BoardPoses(rotations, translations)

    def steps_to(self, other: "BoardPoses", boards: Sequence[int]) -> Array:
        """Return the steps (6 n,) from the poses of some boards to others."""
        chosen = list(boards)
        turns = so3.log(other.rotations[chosen] @ self.rotations[chosen].transpose(0, 2, 1))
        return np.concatenate([other.translations[chosen] - self.translations[chosen], turns], axis=1).ravel()

    def pose(self, board: int) -> Pose:
        """Return body_T_board of one board."""
        return Pose(self.rotations[board], self.translations[board])


@dataclass(frozen=True, eq=False)
class KnownRelation:
    """target_T_source of two boards of one body, by their places, and its covariance (6, 6)."""

    target: int
    source: int
    pose: Pose
    covariance: Array


@dataclass(frozen=True)
class KnownDistance:
    """The distance of two points, m, and its standard deviation. points: their numbers among those of all boards;
    boards: the places of their boards, which are of one body. words: how a person gave it.
    """

    points: tuple[int, int]
    boards: tuple[int, int]
    metres: float
    std: float
    words: str = ""


@dataclass(frozen=True, eq=False)
class Measured:
    """What is known of boards."""

    relations: tuple[KnownRelation, ...] = ()
    distances: tuple[KnownDistance, ...] = ()

    def __bool__(self) -> bool:
        """Return whether there is anything."""
        return bool(self.relations or self.distances)


def measured_blocks(
    known: Measured,
    boards: BoardPoses,
    starts: Mapping[int, int],
    points: Array,
    basis: Array,
    terms: int,
    offsets: int | None = None,
) -> list[Block]:
    """Return what is known as residuals over their standard deviations.

    starts: where the poses of boards begin among the shared parameters, of those that move. points: (C, 3) of the
    boards, each in the frame of its own. basis: (C, 3, S) by the terms of their shape, which begin at `terms`; the
    offsets of points begin at `offsets`, None where they are not among the shared parameters.
    """
    result = []
    for relation in known.relations:
        root = np.linalg.inv(np.linalg.cholesky(relation.covariance))
        apart, by_target, by_source = relation_step(relation, boards)
        jacobians = [
            Jacobian((root @ by)[None], np.arange(starts[board], starts[board] + POSE))
            for board, by in ((relation.target, by_target), (relation.source, by_source))
            if board in starts
        ]
        result.append(Block((root @ apart)[None], tuple(jacobians)))
    for distance in known.distances:
        length, by_boards, by_points = distance_of(distance, boards, points)
        by_terms = sum((by @ basis[point] for point, by in by_points.items()), np.zeros(basis.shape[2]))
        slopes = [(starts[board], by) for board, by in by_boards.items() if board in starts]
        slopes.append((terms, by_terms))
        if offsets is not None:
            slopes += [(offsets + 3 * point, by) for point, by in by_points.items()]
        jacobians = [Jacobian(by[None, None] / distance.std, np.arange(start, start + len(by))) for start, by in slopes]
        result.append(Block(np.array([[(length - distance.metres) / distance.std]]), tuple(jacobians)))
    return result


def relation_step(relation: KnownRelation, boards: BoardPoses) -> tuple[Array, Array, Array]:
    """Return the step (6,) from a known relation to that of the boards' poses, and its derivatives (6, 6) by the steps
    of both of them.
    """
    back = boards.rotations[relation.target].T
    arm = boards.translations[relation.source] - boards.translations[relation.target]
    turned = so3.log(back @ boards.rotations[relation.source] @ relation.pose.rotation.T)
    apart = np.concatenate([back @ arm - relation.pose.translation, turned])
    by_turn = np.linalg.inv(so3.exp_jacobian(turned)) @ back
    by_source, by_target = np.zeros((POSE, POSE)), np.zeros((POSE, POSE))
    by_source[:3, :3], by_source[3:, 3:] = back, by_turn
    by_target[:3, :3], by_target[3:, 3:], by_target[:3, 3:] = -back, -by_turn, back @ so3.hat(arm)
    return apart, by_target, by_source


def distance_of(
    distance: KnownDistance, boards: BoardPoses, points: Array
) -> tuple[float, dict[int, Array], dict[int, Array]]:
    """Return the distance of two points, m, its derivatives by the steps (6,) of their boards, and by the points (3,)
    in the frames of these.
    """
    rotated = [
        boards.rotations[board] @ points[point] for board, point in zip(distance.boards, distance.points, strict=True)
    ]
    ends = [own + boards.translations[board] for own, board in zip(rotated, distance.boards, strict=True)]
    length = float(np.linalg.norm(ends[0] - ends[1]))
    axis = (ends[0] - ends[1]) / max(length, 1e-12)
    by_boards: dict[int, Array] = {}
    by_points: dict[int, Array] = {}
    for sign, board, point, arm in zip((1.0, -1.0), distance.boards, distance.points, rotated, strict=True):
        by_boards[board] = by_boards.get(board, np.zeros(POSE)) + sign * np.concatenate([axis, np.cross(arm, axis)])
        by_points[point] = sign * (axis @ boards.rotations[board])
    return length, by_boards, by_points


def require_measured(
    known: Measured, blocks: Sequence[Block], covariance: Array, inflation: float, names: Sequence[str]
) -> None:
    """Raise InsufficientData if captures, and whatever else is known, contradict what is known of boards.

    blocks: the residuals (1, k) of each, see `measured_blocks`, once all count. covariance: (D, D) of the shared
    parameters by noise alone. inflation: of what captures say, over that.
    """
    found = [_innovation(block, covariance, inflation) for block in blocks]
    limits = [_CONTRADICTED] * len(known.relations) + [_FAR**2] * len(known.distances)
    shares = [squared / limit for (_, squared), limit in zip(found, limits, strict=True)]
    if max(shares, default=0.0) <= 1:
        return
    worst = int(np.argmax(shares))
    apart, squared = found[worst]
    if worst < len(known.relations):
        relation = known.relations[worst]
        apart = np.linalg.cholesky(relation.covariance) @ apart
        name = f"{names[relation.target]}_T_{names[relation.source]}"
        raise contradicted(name, float(np.linalg.norm(apart[:3])), float(np.linalg.norm(apart[3:])))
    distance = known.distances[worst - len(known.relations)]
    length = distance.metres + float(apart[0]) * distance.std
    text = (
        f"--distance {distance.words}: contradicts the captures and what else is known, which say {length:.5g} m "
        f"({np.sqrt(squared):.1f} standard deviations)"
    )
    raise InsufficientData(text, failures=[Message("distance_contradicted", text, {"m": length})])


def _innovation(block: Block, covariance: Array, inflation: float) -> tuple[Array, float]:
    """Return what everything else says of something known, less what is known of it, in the unit of its standard
    deviations (k,), and the χ² of that; without the directions of which nothing else says anything.

    With P the variance of the prediction once it counts, 1 - P is 1 / (1 + D), D the variance by everything else.
    """
    slopes = np.zeros((block.residuals.shape[1], len(covariance)))
    for jacobian in block.shared:
        slopes[:, jacobian.columns] += jacobian.values[0]
    left, axes = np.linalg.eigh(np.eye(len(slopes)) - slopes @ covariance @ slopes.T)
    said = left > _SAID
    left, axes = left[said], axes[:, said]
    along = axes.T @ block.residuals[0] / left
    return axes @ along, float(np.sum(along**2 / (1 + inflation * (1 / left - 1))))


def contradicted(name: str, metres: float, angle: float) -> InsufficientData:
    """Return the error of a known relation that captures contradict, by so much."""
    text = f"the given {name} contradicts the captures, by {1e3 * metres:.3g} mm and {np.degrees(angle):.2g}°"
    return InsufficientData(text, failures=[Message("relation_contradicted", text, {"m": metres, "rad": angle})])
