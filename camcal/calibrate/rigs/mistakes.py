"""Mistakes in the captures of a rig: images that do not belong together, and cameras that moved.

Two cameras see the board where their relative pose says, to within a pixel or so. Where they do not, a few explanations
are tried, each of which changes what belongs together: views of the next capture, views of another capture, of the
other camera, mirrored ones, a board of another size. One that brings the board back to where it should be is named.
A change of the relative pose itself is looked for in the order of the captures.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.initialise import poses_from_pixels, thinned
from camcal.calibrate.problem import BoardProblem
from camcal.calibrate.rigs.links import CameraPoses, Link, link, motions, outline
from camcal.calibrate.rigs.series import SEVERAL, largest_step, mirrored, robust_scale
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.messages import Message, Value, counted
from camcal.targets.board import Board

_SHIFTS = (1, -1, 2, -2)  # captures by which one camera may lag behind another
_BETTER = 0.3  # of the typical error: what an explanation must bring it to
_FAR, _FAR_PX = 6.0, 2.0  # times the typical error, and pixels: beyond both a capture does not fit
_LOOSE = 0.04  # rad; no pair that moves between its exposures is that far off
_AGREEING, _MOST = 2, 0.8  # captures on either side, share of all: what a shift from one on must make fit
_LEAST_PX = 0.3  # of the typical error, however small it is
_SCALE = 0.03  # by which the size of the board in one camera differs that is named
_CLEAR, _CLEAR_PX = 6.0, 0.4  # standard deviations and pixels of a change of the relative pose
_NAMED = 5  # captures in a sentence


@dataclass(frozen=True, eq=False)
class RigCamera:
    """What is asked of a camera here: its name, the poses of its views, and its problem and lens."""

    name: str
    poses: CameraPoses
    problem: BoardProblem
    lens: Array

    @property
    def focal(self) -> float:
        """The focal length in pixels."""
        return float(self.lens[0])

    def within(self, captures: Array) -> "RigCamera":
        """Return what is asked of the camera in some captures, numbered by their places among these."""
        rows = np.flatnonzero(np.isin(self.poses.captures, captures))
        own = _some(self.poses, rows)
        problem = replace(self.problem, observations=self.problem.observations.take(rows), noise=None)
        poses = replace(own, captures=np.searchsorted(captures, own.captures))
        return RigCamera(self.name, poses, problem, self.lens)

    def of_view(self, other: "RigCamera", row: int) -> CameraPoses | None:
        """Return the pose of a view of another camera if this one had taken its image, None where it could not have."""
        table = thinned(other.problem.observations.take(np.array([row])).alike())
        found = poses_from_pixels(self.problem.model, self.lens, self.problem.board, table)
        return None if found is None else CameraPoses(other.poses.captures[[row]], *found)


@dataclass(frozen=True)
class Mistakes:
    """Warnings about single captures, failures of the rig, and the captures whose views are not to be used, by the
    places of cameras.
    """

    warnings: tuple[Message, ...] = ()
    failures: tuple[Message, ...] = ()
    excluded: frozenset[tuple[int, int]] = frozenset()


def mistakes(
    cameras: Sequence[RigCamera], links: Mapping[tuple[int, int], Link], board: Board, captures: Sequence[str]
) -> Mistakes:
    """Return what is wrong with the captures of cameras; captures: their names, in the order they were taken.

    Raises InsufficientData where all captures of two cameras are put together wrongly.
    """
    warnings: list[Message] = []
    failures: list[Message] = []
    excluded: dict[tuple[int, int], int] = {}
    findings: list[_Finding] = []
    pairs = {(a, b): _Pair(cameras[a], cameras[b], board, known) for (a, b), known in sorted(links.items())}
    several = [pair for pair in pairs.values() if len(pair.known.captures) >= SEVERAL]
    for pair in several:
        pair.require_order()
    changes = {key: pair.changes(captures) for key, pair in pairs.items()}
    for pair in several:
        pair.require_consistent(captures, [change for found in changes.values() for change in found])
    for (a, b), pair in pairs.items():
        changed = changes[a, b]
        failures += changed
        found = [] if changed else pair.of_captures(captures)
        findings += found
        for each in found:
            for camera in (a, b):
                excluded[each.capture, camera] = excluded.get((each.capture, camera), 0) + 1
    warnings += _summed_up(findings, captures)
    warnings += _sides(cameras, links)
    # where several cameras saw a capture, the one at fault does not fit any of the others
    worst = {capture: max(count for (own, _), count in excluded.items() if own == capture) for capture, _ in excluded}
    chosen = frozenset(key for key, count in excluded.items() if count == worst[key[0]])
    return Mistakes(tuple(_once(warnings)), tuple(_once(failures)), chosen)


@dataclass(frozen=True)
class _Finding:
    """A capture that does not fit the relative pose of two cameras, by how many pixels; or what makes it fit, and by
    how many pixels it is off then.
    """

    capture: int
    error: float
    message: Message | None = None


def _summed_up(findings: Sequence[_Finding], captures: Sequence[str]) -> list[Message]:
    """Return one message for each capture that something makes fit, and one for all others."""
    explained: dict[int, _Finding] = {}
    for each in findings:
        if each.message and (each.capture not in explained or each.error < explained[each.capture].error):
            explained[each.capture] = each
    result = [each.message for _, each in sorted(explained.items()) if each.message]
    left = [each for each in findings if each.capture not in explained]
    if left:
        names = [captures[capture] for capture in sorted({each.capture for each in left})]
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        error = float(np.median([each.error for each in left]))
        text = (
            f"{counted(len(names), 'capture')} inconsistent with the others, by {error:.2g} px: "
            f"{', '.join(names[:_NAMED])}{more}; not used"
        )
        result.append(Message("inconsistent_captures", text, {"captures": tuple(names), "px": error}))
    return list(_once(result))


def _once(messages: Sequence[Message]) -> Iterator[Message]:
    seen: set[str] = set()
    for message in messages:
        if message.text not in seen:
            seen.add(message.text)
            yield message


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two cameras a and b and their relative pose b_T_a."""

    a: RigCamera
    b: RigCamera
    board: Board
    known: Link

    def rows(self) -> tuple[Array, Array]:
        """Return the places among the views of a and of b of the common captures."""
        rows_a = np.searchsorted(self.a.poses.captures, self.known.captures)
        return rows_a, np.searchsorted(self.b.poses.captures, self.known.captures)

    def errors(self, poses_a: CameraPoses, poses_b: CameraPoses, known: Link) -> Array:
        """Return how far, px of b, the board is from where the relative pose expects it: (n,) of as many poses."""
        return np.asarray(np.sqrt(np.mean(np.sum(self.offsets(poses_a, poses_b, known) ** 2, axis=2), axis=1)))

    def offsets(self, poses_a: CameraPoses, poses_b: CameraPoses, known: Link) -> Array:
        """Return by how much points of the board are beside their expected places, (n, P, 3) px of b, numbered from
        the end of a symmetric board that fits best.
        """
        points = outline(self.board)
        seen = points @ poses_a.rotations.transpose(0, 2, 1) + poses_a.translations[:, None]
        expected = _unit(seen @ known.rotation.T + known.translation)
        best: Array | None = None
        for turn, shift in zip(*motions(self.board), strict=True):
            turned = points @ turn.T + shift
            there = _unit(turned @ poses_b.rotations.transpose(0, 2, 1) + poses_b.translations[:, None])
            found = self.b.focal * (there - expected)
            if best is None:
                best = found
            else:
                nearer = np.sum(found**2, axis=(1, 2)) < np.sum(best**2, axis=(1, 2))
                best = np.where(nearer[:, None, None], found, best)
        assert best is not None
        return best

    def typical(self, known: Link, a: CameraPoses, b: CameraPoses) -> float:
        """Return the typical error, px, of the common captures of two cameras under a relative pose."""
        _, rows_a, rows_b = np.intersect1d(a.captures, b.captures, return_indices=True)
        return float(np.median(self.errors(_some(a, rows_a), _some(b, rows_b), known)))

    def require_order(self) -> None:
        """Raise InsufficientData if all captures fit another way of putting them together much better."""
        a, b = self.a.poses, self.b.poses
        typical = max(self.typical(self.known, a, b), _LEAST_PX)
        for shift in _SHIFTS:
            moved = replace(b, captures=b.captures + shift)
            found = link(a, moved, self.board)
            enough = found is not None and len(found.captures) >= max(SEVERAL, len(self.known.captures) // 2)
            if found is not None and enough and self.typical(found, a, moved) < _BETTER * typical:
                late, early = (self.b, self.a) if shift < 0 else (self.a, self.b)
                text = (
                    f"images of {late.name} are {counted(abs(shift), 'capture')} late against those of {early.name}: "
                    "check for a missing image, or use --match"
                )
                raise _refused("shifted_captures", text, {"captures": shift})
        for camera, pair in self._mirrorings(a, b):
            found = link(*pair, self.board)
            if found is not None and self.typical(found, *pair) < _BETTER * typical:
                text = f"images of {camera.name} are mirrored: calibrate with the images as the sensor gives them"
                raise _refused("mirrored_images", text, {})
        self._require_size()

    def require_consistent(self, captures: Sequence[str], changes: Sequence[Message]) -> None:
        """Raise InsufficientData if half of the captures or more do not fit the relative pose of the others.

        It names the reason: the first of `changes` that other pairs of cameras show, or a shift from a capture on.
        """
        errors = self.errors(*self.common(), self.known)
        fitting = self._fitting(errors)
        if 2 * fitting.sum() > len(errors):
            return
        shifted = self._late_shift(captures)
        reasons = [shifted] if shifted else changes
        if reasons:
            raise InsufficientData(reasons[0].text, failures=reasons)
        text = (
            f"captures of {self.a.name} and {self.b.name} do not belong together: {np.sum(~fitting)} of "
            f"{len(errors)} do not fit the relative pose of the others, by {np.median(errors[~fitting]):.2g} px"
        )
        raise _refused("inconsistent_captures", text, {"captures": int(np.sum(~fitting))})

    def _fitting(self, errors: Array) -> Array:
        """Return which of the common captures (n,) fit the relative pose that most agree with, by their errors, px."""
        limit = max(_FAR * float(np.quantile(errors, 0.2)), _FAR_PX)
        return errors < min(limit, max(_LOOSE * self.b.focal, _FAR_PX))

    def _late_shift(self, captures: Sequence[str]) -> Message | None:
        """Return the message about captures that fit when b is shifted from one of them on, None without any."""
        tried = [(self._late_fits(start, shift), start, shift) for start in range(len(captures)) for shift in _SHIFTS]
        fits, start, shift = max(tried, key=lambda each: each[0])
        if fits < _MOST:
            return None
        text = (
            f"captures of {self.a.name} and {self.b.name} are shifted by {counted(abs(shift), 'capture')} from capture "
            f"{captures[start]} on: check for a missing image, or use --match"
        )
        return Message("shifted_captures", text, {"capture": captures[start], "captures": shift})

    def _late_fits(self, start: int, shift: int) -> float:
        """Return the share of common captures that fit if b is shifted from the capture `start` on, 0 where few do."""
        a, b = self.a.poses, self.b.poses
        numbers = b.captures + np.where(b.captures >= start, shift, 0)
        kept = (numbers < start) == (b.captures < start)
        moved = _some(replace(b, captures=numbers), np.flatnonzero(kept))
        known = link(a, moved, self.board)
        if known is None:
            return 0.0
        _, of_a, of_b = np.intersect1d(a.captures, moved.captures, return_indices=True)
        fitting = self._fitting(self.errors(_some(a, of_a), _some(moved, of_b), known))
        late = known.captures >= start
        enough = min(np.sum(fitting & late), np.sum(fitting & ~late)) >= _AGREEING
        return float(np.mean(fitting)) if enough else 0.0

    def common(self) -> tuple[CameraPoses, CameraPoses]:
        """Return the poses of both cameras in their common captures."""
        rows_a, rows_b = self.rows()
        return _some(self.a.poses, rows_a), _some(self.b.poses, rows_b)

    def _mirrorings(
        self, a: CameraPoses, b: CameraPoses
    ) -> Iterator[tuple[RigCamera, tuple[CameraPoses, CameraPoses]]]:
        """Yield the camera whose images may be mirrored, and the poses as they would be without."""
        for own in mirrored(b, self.board):
            yield self.b, (a, own)
        for own in mirrored(a, self.board):
            yield self.a, (own, b)

    def _require_size(self) -> None:
        """Raise InsufficientData if the board is of another size in the images of b."""
        a, b = self.common()
        turns = b.rotations @ a.rotations.transpose(0, 2, 1)
        away = np.linalg.norm(so3.log(turns[:, None] @ turns.transpose(0, 2, 1)), axis=2)
        turn = turns[int(np.argmin(np.median(away, axis=1)))]  # sizes do not change rotations
        found = robust_scale(a.translations @ turn.T, b.rotations, b.translations)
        if found is None:
            return
        scale, before, after = found
        if abs(np.log(scale)) > np.log1p(_SCALE) and after < _BETTER * before:
            size = scale if scale > 1 else 1 / scale
            larger, smaller = (self.b, self.a) if scale > 1 else (self.a, self.b)
            text = (
                f"the board of {larger.name} is {size:.3g} times as large as that of {smaller.name}: another board, "
                "or another square size in --board"
            )
            raise _refused("boards_of_two_sizes", text, {"ratio": scale})

    def of_captures(self, captures: Sequence[str]) -> list[_Finding]:
        """Return what is found about the captures that do not fit."""
        a, b = self.common()
        errors = self.errors(a, b, self.known)
        limit = max(_FAR * float(np.median(errors)), _FAR_PX)
        wrong = np.flatnonzero(errors > limit)
        if not len(wrong) or 2 * len(wrong) > len(errors):
            return []
        result, left = [], wrong.tolist()
        for one, other in combinations(wrong.tolist(), 2):
            crossed = self.errors(_some(a, [one, other]), _some(b, [other, one]), self.known)
            if {one, other} <= set(left) and (crossed < np.maximum(_BETTER * errors[[one, other]], limit / _FAR)).all():
                names = [captures[self.known.captures[each]] for each in (one, other)]
                text = f"images of {self.a.name} or {self.b.name} exchanged between captures {' and '.join(names)}"
                message = Message("exchanged_images", text, {"captures": tuple(names)})
                result += [
                    _Finding(int(self.known.captures[each]), float(crossed.max()), message) for each in (one, other)
                ]
                left = [each for each in left if each not in (one, other)]
        return result + [self._of_capture(one, float(errors[one]), captures) for one in left]

    def _of_capture(self, row: int, error: float, captures: Sequence[str]) -> _Finding:
        """Return what makes one of the common captures fit best, or by how much it does not."""
        capture = int(self.known.captures[row])
        rows_a, rows_b = (int(rows[row]) for rows in self.rows())
        a, b = _some(self.a.poses, [rows_a]), _some(self.b.poses, [rows_b])
        values: dict[str, Value] = {"capture": captures[capture]}
        where = f"capture {captures[capture]}"
        tried = [
            (
                float(self.errors(*pair, self.known)[0]),
                Message("mirrored_images", f"{where}: image of {camera.name} mirrored", values),
            )
            for camera, pair in self._mirrorings(a, b)
        ]
        as_a, as_b = self.a.of_view(self.b, rows_b), self.b.of_view(self.a, rows_a)
        if as_a is not None and as_b is not None:
            message = Message("swapped_views", f"{where}: images of {self.a.name} and {self.b.name} swapped", values)
            tried.append((float(self.errors(as_a, as_b, self.known)[0]), message))
        left, message = min(tried, key=lambda each: each[0])
        return _Finding(capture, left, message) if left < _BETTER * error else _Finding(capture, error)

    def changes(self, captures: Sequence[str]) -> list[Message]:
        """Return the message about a relative pose that changed from one capture on."""
        a, b = self.common()
        numbers = self.known.captures
        if len(numbers) < 2 * SEVERAL:
            return []
        beside = self.offsets(a, b, self.known)[:, -1]  # of the board's centre
        place, size, clear = largest_step(beside)
        if clear < _CLEAR or size < _CLEAR_PX:
            return []
        shifted = self._late_shift(captures)
        if shifted:
            return [shifted]
        name = captures[numbers[place]]
        text = (
            f"relative pose of {self.a.name} and {self.b.name} changed from capture {name} on, by {size:.2g} px: "
            "calibrate the captures before and after it separately"
        )
        return [Message("rig_changed", text, {"capture": name, "px": size})]


def _unit(points: Array) -> Array:
    return np.asarray(points / np.maximum(np.linalg.norm(points, axis=-1, keepdims=True), 1e-300))


def _some(poses: CameraPoses, rows: Array | Sequence[int]) -> CameraPoses:
    index = np.asarray(rows, np.intp)
    return CameraPoses(poses.captures[index], poses.rotations[index], poses.translations[index])


def _sides(cameras: Sequence[RigCamera], links: Mapping[tuple[int, int], Link]) -> list[Message]:
    """Return the warning that cameras called left and right are the other way round."""
    result = []
    for (a, b), known in links.items():
        names = [cameras[place].name.lower() for place in (a, b)]
        turned = np.linalg.norm(so3.log(known.rotation)) > np.pi / 2
        x, y, z = np.abs(known.translation)
        if turned or x < max(y, z):
            continue
        for left, right, sign in ((0, 1, 1.0), (1, 0, -1.0)):
            if "left" in names[left] and "right" in names[right] and sign * known.translation[0] > 0:
                text = f"{cameras[(a, b)[right]].name} is left of {cameras[(a, b)[left]].name}: swapped, or upside down"
                result.append(Message("left_right_swapped", text))
    return result


def _refused(code: str, text: str, values: Mapping[str, float]) -> InsufficientData:
    return InsufficientData(text, failures=[Message(code, text, values)])
