"""A robot's poses over time, and in which way they are to be read, told by what the camera saw.

What a pair of poses turns by is the same for hand and eye, whatever hand and eye are: that tells the form of rotations.
The closed form of hand and eye then tells direction and unit. A list shifted against the images, a board or a camera
that has moved, and a hand that turned about one axis only are told from it as well. Images may have another clock.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.robot.problem import HandEye, Poses, angle_mismatch, closed_form, motions, pairs_of, turn_angles
from camcal.dataclass import dataclass, replace
from camcal.geometry import rotation as so3

LEAST_POSES = 5
_BETTER = 3.0  # times: by so much another reading has to fit better than the one that was said
_MOST_FORMS = 12  # that are looked at closely, as many as turn by the same: of a wrong list all fit as badly
_SHIFTS = (1, -1, 2, -2)
_AXES = 0.15  # of the spread of turns about the first axis, that about the second
_LEAST_TURN = 0.0873  # rad
_BLOCK = 3  # poses that stand apart at the least
_MOVED = 25.0  # F of the difference of two means
_APART = 4.0  # that difference, in standard deviations of one coordinate
_SAME_PLACE = 1e-5  # m
_SAME_TURN = 9e-5  # rad
_TINY = 1e-7
_FARTHEST = 20.0  # m, of a board
_MILLI = 1e-3
_ROUNDED = 1.7e-4  # rad, of angles in a list

_LATEST = 2.0  # s, by which two clocks are taken to differ at most
_SHARE = 0.25  # of the time that the poses take
_MOST = 2000  # delays that are tried


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to read a robot's poses. words: what it takes them for. inverted: whether they are hand_T_base. scale: m
    in their unit of length. poses: base_T_hand (N,), metres. fit: hand and eye of them.
    """

    words: str
    inverted: bool
    scale: float
    poses: Poses
    fit: HandEye


def read_robot(
    candidates: Sequence[tuple[str, Poses]],
    camera: Poses,
    scales: Sequence[float],
    directions: Sequence[bool],
    in_hand: bool,
) -> tuple[Reading, ...]:
    """Return the readings of a robot's poses, the likeliest first.

    candidates: forms by their names, with poses (N,) in the unit of the file; camera: camera_T_board of the same
    moments. scales: the lengths that the unit may have. directions: whether the poses may be hand_T_base.
    """
    readings = []
    for place in _likely([angle_mismatch(poses, camera) for _, poses in candidates]):
        words, poses = candidates[place]
        for scale in scales:
            scaled = replace(poses, translations=poses.translations * scale)
            for inverted in directions:
                known = scaled.inverse() if inverted else scaled
                readings.append(Reading(words, inverted, scale, known, closed_form(_carrier(known, in_hand), camera)))
    return tuple(sorted(readings, key=lambda own: own.fit.score))


def seen_form(
    robot: Sequence[tuple[str, Poses]], camera: Sequence[tuple[str, Poses]], scales: Sequence[float], in_hand: bool
) -> tuple[str, Poses]:
    """Return the form that camera_T_board (N,) has been written in, by what the robot's poses say.

    Both are given in the forms that they may have, and may be shifted against each other; poses in the other
    direction are turned about: the board is in front of the camera, so that no depth is below zero. Lengths that no
    camera sees a board at are in mm.
    """
    apart = np.full(len(camera), np.inf)
    for shift, rows in _shifts(len(camera[0][1].rotations)):
        angles = np.stack([turn_angles(poses.take(rows + shift)) for _, poses in robot])
        here = [np.median(np.abs(angles - turn_angles(own.take(rows).inverse())), axis=1).min() for _, own in camera]
        apart = np.minimum(apart, here)
    found = []
    for place in _likely(apart.tolist()):
        words, poses = camera[place]
        back = poses.inverse()
        inverted = poses.translations[:, 2].min() <= 0 < back.translations[:, 2].min()
        known, said = (back, f"{words}, board_T_camera") if inverted else (poses, words)
        if float(np.median(np.linalg.norm(known.translations, axis=1))) > _FARTHEST:
            known, said = replace(known, translations=known.translations * _MILLI), f"{said}, mm"
        found.append((said, known))
    if len(found) == 1:
        return found[0]
    return min(found, key=lambda own: read_robot(robot, own[1], scales, (False, True), in_hand)[0].fit.score)


def _likely(mismatches: Sequence[float]) -> list[int]:
    """Return the places of forms whose angles fit, the best first; mirrored orders of Euler angles turn by the same."""
    limit = _BETTER * min(mismatches) + _TINY
    order = sorted(range(len(mismatches)), key=lambda place: mismatches[place])
    return [place for place in order if mismatches[place] <= limit][:_MOST_FORMS]


def _carrier(base_T_hand: Poses, in_hand: bool) -> Poses:
    return base_T_hand if in_hand else base_T_hand.inverse()


def fits_better(own: HandEye, other: HandEye) -> bool:
    """Return whether another reading fits so much better that the first one is a mistake."""
    return own.score > _BETTER * other.score + _TINY


def _shifts(count: int) -> Iterator[tuple[int, Array]]:
    """Yield by how much a list of so many images may be shifted, 0 first, and the places of those that have a pose."""
    for shift in (0, *_SHIFTS) if count > LEAST_POSES + 2 else (0,):
        yield shift, np.arange(max(0, -shift), min(count, count - shift))


def shift_of(candidates: Sequence[tuple[str, Poses]], camera: Poses) -> int:
    """Return by how many places the list of poses is shifted against the images, 0 if it is not."""
    found = {}
    for shift, rows in _shifts(len(camera.rotations)):
        seen = camera.take(rows)
        found[shift] = min(angle_mismatch(poses.take(rows + shift), seen) for _, poses in candidates)
    best = min(found, key=lambda shift: found[shift])
    return best if found[0] > _BETTER * found[best] + _ROUNDED else 0


def undetermined_axis(poses: Poses) -> Array | None:
    """Return the axis (3,) in the hand's frame that it turned about, if it turned about hardly any other; zeros if it
    hardly turned at all; None if it turned about two.
    """
    turns = so3.log(motions(poses, pairs_of(len(poses.rotations))).rotations)
    if np.linalg.norm(turns, axis=1).max(initial=0.0) < _LEAST_TURN:
        return np.zeros(3)
    values, vectors = np.linalg.eigh(turns.T @ turns)
    return np.asarray(vectors[:, 2]) if np.sqrt(max(values[1], 0.0) / values[2]) < _AXES else None


def moved_from(fit: HandEye) -> int | None:
    """Return from which pose on the board stands elsewhere than before, in what it stands still in; None for none.

    Of all places to divide the list the one with the largest F of the difference of the means.
    """
    places, count = fit.boards, len(fit.boards)
    best, place = 0.0, None
    for first in range(_BLOCK, count - _BLOCK + 1):
        parts = places[:first], places[first:]
        within = sum(float(np.sum((part - part.mean(axis=0)) ** 2)) for part in parts) / (3 * (count - 2)) + _TINY**2
        apart = float(np.sum((parts[0].mean(axis=0) - parts[1].mean(axis=0)) ** 2))
        ratio = apart / (3 * within * (1 / first + 1 / (count - first)))
        if ratio > best and apart > _APART**2 * within:
            best, place = ratio, first
    return place if best > _MOVED else None


def duplicates(poses: Poses) -> int:
    """Return how many poses are the same as one before."""
    apart = np.linalg.norm(poses.translations[:, None] - poses.translations[None], axis=2)
    turned = np.linalg.norm(so3.log(poses.rotations[:, None].swapaxes(-1, -2) @ poses.rotations[None]), axis=2)
    same = (apart < _SAME_PLACE) & (turned < _SAME_TURN)
    return int(np.triu(same, 1).any(axis=0).sum())


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses base_T_hand (T,) at times (T,) s, in ascending order."""

    times: Array
    poses: Poses

    def at(self, times: Array) -> Poses:
        """Return the poses (N,) at other times, on the straightest way between two; the last one beyond the end."""
        first = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        before, after = self.poses.take(first), self.poses.take(first + 1)
        share = np.clip((times - self.times[first]) / (self.times[first + 1] - self.times[first]), 0.0, 1.0)
        moved = before.translations + share[:, None] * (after.translations - before.translations)
        return Poses(so3.between(before.rotations, after.rotations, share), moved)

    def velocities(self, times: Array) -> Array:
        """Return the velocities (N, 6) of the hand: m/s in the base, rad/s in its own frame."""
        half = float(np.median(np.diff(self.times))) / 2
        before, after = self.at(times - half), self.at(times + half)
        turns = so3.log(before.rotations.transpose(0, 2, 1) @ after.rotations)
        return np.concatenate([after.translations - before.translations, turns], axis=1) / (2 * half)

    def delay(self, times: Array, camera: Poses) -> float:
        """Return by how many s the poses are late against images at `times` (N,), to half an interval of the poses.

        camera: camera_T_board (N,) of the images.
        """
        step = float(np.median(np.diff(self.times)))
        reach = min(_LATEST, _SHARE * float(self.times[-1] - self.times[0]))
        count = int(min(reach / step, _MOST / 2))
        delays = np.linspace(-reach, reach, 2 * count + 1) if count else np.zeros(1)
        return float(min(delays, key=lambda delay: (angle_mismatch(self.at(times + delay), camera), abs(delay))))
