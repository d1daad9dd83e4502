"""Where cameras and boards are to begin with, and which of them the captures link.

Cameras that saw one board in one capture are linked by it, boards of one body by a group of linked cameras that saw
both in one capture, and groups of cameras by any two boards that are linked. Where groups see boards of their own only,
the motion links them: with K₁_T_L₁ and K₂_T_L₂ of the same captures, L₁_T_K₁ · K₁_T_K₂ · K₂_T_L₂ = L₁_T_L₂ for all of
them, as of a hand and an eye. That leaves open what a motion about one axis leaves open.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.rigs.links import CameraPoses, Placed
from camcal.calibrate.rigs.measured import BoardPoses, KnownRelation, contradicted
from camcal.calibrate.rigs.record import Captures
from camcal.calibrate.robot.problem import Poses, centre, closed_form
from camcal.calibrate.robot.reading import undetermined_axis
from camcal.dataclass import dataclass
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.geometry.pose import Pose
from camcal.messages import Message
from camcal.targets.board import Board

_LEAST_MOTIONS = 4  # captures from which a motion links groups of cameras
_APART = 0.05  # of the distance of the boards: boards that are not joined
_TURNED_DEG = 5.0
_MISFIT = 0.1  # of what a body moves by: a motion that is not that of one body


@dataclass(frozen=True)
class Rows:
    """What the rows of captures are: of each the place of its board (R,) and the number of its moment (R,). boards: the
    names; bodies: (B,) numbers of the bodies that they are said to be of.
    """

    board: Array
    moment: Array
    boards: tuple[str, ...]
    bodies: tuple[int, ...]

    @classmethod
    def of(cls, captures: Captures, board: Board, joined: Sequence[Sequence[str]] | None) -> "Rows":
        """Return what the rows of captures are; joined: groups of boards that are, None: all are."""
        count, names = len(captures), tuple(board.members)
        body_of = {name: place for place, body in enumerate((names,) if joined is None else joined) for name in body}
        return cls(
            np.array(captures.boards or [0] * count, np.intp),
            np.array(captures.moments or range(count), np.intp),
            names,
            tuple(body_of.get(name, -1 - place) for place, name in enumerate(names)),
        )


@dataclass(frozen=True, eq=False)
class PlacedRig:
    """Where cameras (by their places) and boards are. bodies: (B,) of each board the one it is on, as far as boards are
    linked, by the place of its first board. messages: what is not linked.
    """

    cameras: Placed
    boards: BoardPoses
    bodies: tuple[int, ...]
    messages: tuple[Message, ...] = ()

    @property
    def attached(self) -> tuple[int, ...]:
        """The boards that are on a body of another one."""
        return tuple(board for board, body in enumerate(self.bodies) if board != body)

    @property
    def roots(self) -> tuple[int, ...]:
        """The first boards of the bodies that these are on."""
        return tuple(self.bodies[board] for board in self.attached)


_Members = list[dict[int, Pose]]  # groups of things that are linked to each other: their poses thing_T_group


def _join(groups: _Members, first: int, second: int, first_T_second: Pose) -> None:
    """Join two groups, by their places; the second is gone."""
    back = first_T_second.inverse()
    groups[first] |= {thing: pose @ back for thing, pose in groups[second].items()}
    del groups[second]


def place_rig(
    cameras: Sequence[CameraPoses],
    linked: Sequence[Placed],
    rows: Rows,
    names: Sequence[str],
    known: Sequence[KnownRelation] = (),
) -> PlacedRig:
    """Return where cameras and boards are, of the largest group of cameras that captures link.

    cameras: the poses of their views, whose captures are rows. linked: groups of cameras by common rows, see
    `links.place`. Raises InsufficientData where boards that are said to be joined move against each other, where known
    relations do not fit, and where the motion that links groups does not determine how they stand.
    """
    groups = [
        {camera: Pose(own.rotations[camera], own.translations[camera]) for camera in own.rotations} for own in linked
    ]
    boards = [{board: Pose.identity()} for board in range(len(rows.boards))]
    seen = _Linking(cameras, rows, groups, boards)
    for relation in known:
        seen.check_known(relation)
        seen.join_known(relation)
    refused: list[Message] = []
    while seen.join_boards() or seen.join_cameras() or seen.join_by_motion(names, refused):
        pass
    chosen = min(groups, key=lambda own: (-len(own), min(own)))
    first = chosen[min(chosen)].inverse()
    poses = {camera: chosen[camera] @ first for camera in sorted(chosen)}
    bodies, on_body = list(range(len(rows.boards))), BoardPoses.one(len(rows.boards))
    for own in boards:
        root = min(own)
        for board, pose in own.items():
            root_T_board = own[root] @ pose.inverse()
            bodies[board] = root
            on_body.rotations[board], on_body.translations[board] = root_T_board.rotation, root_T_board.translation
    seen_boards: set[int] = {
        board for camera in chosen for board in np.unique(rows.board[cameras[camera].captures]).tolist()
    }
    messages = [*_unlinked_boards(rows, bodies, seen_boards), *refused]
    if len(chosen) < len(cameras) and refused:
        raise InsufficientData(refused[0].text, failures=refused)
    placed = Placed(
        {camera: pose.rotation for camera, pose in poses.items()},
        {camera: pose.translation for camera, pose in poses.items()},
    )
    return PlacedRig(placed, on_body, tuple(bodies), tuple(messages))


def _unlinked_boards(rows: Rows, bodies: Sequence[int], seen: set[int]) -> Iterator[Message]:
    """Yield what is said of boards of one body that nothing links."""
    for body in dict.fromkeys(rows.bodies):
        roots = dict.fromkeys(bodies[board] for board in sorted(seen) if rows.bodies[board] == body)
        if len(roots) > 1:
            groups = [
                ", ".join(rows.boards[board] for board in sorted(seen) if bodies[board] == root) for root in roots
            ]
            text = (
                f"boards {' and '.join(groups)} are not linked: no capture shows both to cameras that are linked; add "
                "captures that do, or captures in which cameras of either see theirs while all turn about two axes"
            )
            yield Message("unlinked_boards", text, {"groups": tuple(groups)})


@dataclass(frozen=True, eq=False)
class _Linking:
    """What groups of cameras see of groups of boards."""

    cameras: Sequence[CameraPoses]
    rows: Rows
    groups: _Members
    boards: _Members

    def poses(self, group: int, body: int) -> dict[int, Pose]:
        """Return group_T_body of a group of cameras and one of boards by the moments of captures."""
        found: dict[int, list[Pose]] = {}
        for camera, camera_T_group in self.groups[group].items():
            own, back = self.cameras[camera], camera_T_group.inverse()
            for row, rotation, translation in zip(own.captures, own.rotations, own.translations, strict=True):
                board_T_body = self.boards[body].get(int(self.rows.board[row]))
                if board_T_body is not None:
                    pose = back @ Pose(rotation, translation) @ board_T_body
                    found.setdefault(int(self.rows.moment[row]), []).append(pose)
        return {moment: _mean(poses) for moment, poses in found.items()}

    def _body(self, group: int) -> int:
        return self.rows.bodies[min(self.boards[group])]

    def _pairs_of_boards(self) -> Iterator[tuple[int, int]]:
        for one, other in combinations(range(len(self.boards)), 2):
            if self._body(one) == self._body(other):
                yield one, other

    def _place_of(self, board: int) -> int:
        return next(place for place, own in enumerate(self.boards) if board in own)

    def relation(self, one: int, other: int) -> tuple[Pose, Poses, float] | None:
        """Return one_T_other of two groups of boards that cameras saw in one capture, what captures say of it, and how
        far boards are from cameras; None where none did.
        """
        found: list[Pose] = []
        far: list[float] = []
        for group in range(len(self.groups)):
            first, second = self.poses(group, one), self.poses(group, other)
            found += [first[moment].inverse() @ second[moment] for moment in first if moment in second]
            far += [float(np.linalg.norm(first[moment].translation)) for moment in first if moment in second]
        return (centre(stacked(found)), stacked(found), float(np.median(far))) if found else None

    def join_known(self, relation: KnownRelation) -> None:
        """Join the groups of two boards by what is known of them."""
        target, source = (self._place_of(board) for board in (relation.target, relation.source))
        if target == source:
            return
        to_target = self.boards[target][relation.target].inverse()
        first_T_second = to_target @ relation.pose @ self.boards[source][relation.source]
        first, second = min(target, source), max(target, source)
        _join(self.boards, first, second, first_T_second if first == target else first_T_second.inverse())

    def check_known(self, relation: KnownRelation) -> None:
        """Raise InsufficientData if captures say something else of two boards."""
        target, source = (self._place_of(board) for board in (relation.target, relation.source))
        found = self.relation(target, source) if target != source else None
        if found is None:
            return
        seen, _, far = found
        to_target = self.boards[target][relation.target]
        seen = to_target @ seen @ self.boards[source][relation.source].inverse()
        apart = np.linalg.norm(seen.translation - relation.pose.translation)
        turned = np.linalg.norm(so3.log(seen.rotation @ relation.pose.rotation.T))
        spread = np.sqrt([np.trace(relation.covariance[:3, :3]), np.trace(relation.covariance[3:, 3:])])
        if apart > _APART * far + 5 * spread[0] or turned > np.radians(_TURNED_DEG) + 5 * spread[1]:
            names = [self.rows.boards[board] for board in (relation.target, relation.source)]
            raise contradicted(f"{names[0]}_T_{names[1]}", float(apart), float(turned))

    def join_boards(self) -> bool:
        """Join two groups of boards that cameras saw together; return whether there were any."""
        for one, other in self._pairs_of_boards():
            found = self.relation(one, other)
            if found is None:
                continue
            pose, poses, far = found
            shifts = np.linalg.norm(poses.translations - pose.translation, axis=1)
            turns = np.linalg.norm(so3.log(pose.rotation.T @ poses.rotations), axis=1)
            if np.median(shifts) > _APART * far or np.degrees(np.median(turns)) > _TURNED_DEG:
                names = [self.rows.boards[min(self.boards[place])] for place in (one, other)]
                text = (
                    f"boards {names[0]} and {names[1]} move against each other, by {1e3 * np.median(shifts):.2g} mm "
                    f"and {np.degrees(np.median(turns)):.2g}° (median): they are not joined; use --joined none"
                )
                raise InsufficientData(text, failures=[Message("boards_not_joined", text)])
            _join(self.boards, one, other, pose)
            return True
        return False

    def join_cameras(self) -> bool:
        """Join two groups of cameras that saw one group of boards in a capture; return whether there were any."""
        for first, second in combinations(range(len(self.groups)), 2):
            found: list[Pose] = []
            for body in range(len(self.boards)):
                one, other = self.poses(first, body), self.poses(second, body)
                found += [one[moment] @ other[moment].inverse() for moment in one if moment in other]
            if found:
                _join(self.groups, first, second, centre(stacked(found)))
                return True
        return False

    def join_by_motion(self, names: Sequence[str], refused: list[Message]) -> bool:
        """Join two groups of cameras, and the boards that they see, by the motion; return whether there were any.

        refused: messages about motions that do not determine how groups stand.
        """
        refused.clear()
        best: tuple[int, int, int, int, int, list[Pose], list[Pose]] | None = None
        for first, second in combinations(range(len(self.groups)), 2):
            for pair in self._pairs_of_boards():
                for body, beside in (pair, pair[::-1]):
                    one, other = self.poses(first, body), self.poses(second, beside)
                    common = [moment for moment in one if moment in other]
                    if len(common) >= _LEAST_MOTIONS and (best is None or len(common) > best[0]):
                        motion = [one[moment].inverse() for moment in common], [other[moment] for moment in common]
                        if (text := self._undetermined(first, second, motion[0], names)) is not None:
                            refused.append(Message("undetermined_motion", text))
                            continue
                        best = (len(common), first, second, body, beside, *motion)
        if best is None:
            return False
        _, first, second, body, beside, carried, seen = best
        fit = closed_form(stacked(carried), stacked(seen))
        if np.median(fit.shifts) > _MISFIT * fit.reach or np.degrees(np.median(fit.turns)) > _TURNED_DEG:
            boards = " and ".join(self.rows.boards[min(self.boards[place])] for place in (body, beside))
            text = (
                f"captures do not fit boards {boards} that are joined: they move against each other, or captures are "
                "not matched; use --joined none for boards that are not joined"
            )
            raise InsufficientData(text, failures=[Message("boards_not_joined", text)])
        _join(self.groups, first, second, fit.carrier_T_camera)
        body_T_beside = fit.world_T_board if body < beside else fit.world_T_board.inverse()
        _join(self.boards, min(body, beside), max(body, beside), body_T_beside)
        return True

    def _undetermined(self, first: int, second: int, carried: Sequence[Pose], names: Sequence[str]) -> str | None:
        """Return what motions do not determine of how two groups of cameras stand, None where they determine all."""
        axis = undetermined_axis(stacked(carried))
        if axis is None:
            return None
        groups = [", ".join(names[camera] for camera in sorted(self.groups[own])) for own in (first, second)]
        if not axis.any():
            return (
                f"cameras {groups[0]} and {groups[1]} see boards of their own only, and hardly turn against them: how "
                "they stand to each other is not determined; turn rig or boards by 30° and more about two axes"
            )
        own = self.groups[first]
        axis = own[min(own)].rotation @ axis
        words = ", ".join(f"{value:.2f}" for value in axis * np.sign(axis[np.argmax(np.abs(axis))]))
        return (
            f"cameras {groups[0]} and {groups[1]} see boards of their own only, and turn about one axis, ({words}) of "
            f"{names[min(own)]}: the shift between them along it is not determined; turn about a second axis by 30°"
        )


def stacked(poses: Sequence[Pose]) -> Poses:
    """Return poses as arrays."""
    return Poses(np.stack([own.rotation for own in poses]), np.stack([own.translation for own in poses]))


def _mean(poses: Sequence[Pose]) -> Pose:
    """Return the mean of poses that differ little."""
    if len(poses) == 1:
        return poses[0]
    first = poses[0].rotation
    turn = so3.exp(np.mean([so3.log(first.T @ own.rotation) for own in poses], axis=0))
    return Pose(first @ turn, np.mean([own.translation for own in poses], axis=0))


def groups_of(rows: Rows, bodies: Sequence[int], used: Array) -> tuple[Array, Array]:
    """Return the group (R,) of every row, -1 for those that are not used, and the first row (G,) of each group: rows of
    one moment and body.
    """
    keys = rows.moment * (len(rows.boards) + 1) + np.array(bodies)[rows.board]
    known, first = np.unique(keys[used], return_index=True)
    group = np.full(len(keys), -1, np.intp)
    group[used] = np.searchsorted(known, keys[used])
    return group, used[first]
