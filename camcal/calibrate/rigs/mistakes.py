"""Mistakes in the captures of a rig: images that do not belong together, and cameras that moved.

Two cameras see the board where their relative pose says, to within a pixel or so. Where they do not, a few explanations
are tried, each of which changes what belongs together: views of the next capture, views of another capture, of the
other camera, mirrored ones, a board of another size. One that brings the board back to where it should be is named.
A change of the relative pose itself is looked for in the order of the captures.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from camcal.arrays import Array
from camcal.calibrate.rigs.links import CameraPoses, Link, link, motions, outline
from camcal.errors import InsufficientData
from camcal.geometry import rotation as so3
from camcal.messages import Message, counted
from camcal.targets.board import Board

_SHIFTS = (1, -1, 2, -2)  # captures by which one camera may lag behind another
_BETTER = 0.3  # of the typical error: what an explanation must bring it to
_FAR, _FAR_PX = 6.0, 2.0  # times the typical error, and pixels: beyond both a capture does not fit
_LEAST_PX = 0.3  # of the typical error, however small it is
_SCALE = 0.03  # by which the size of the board in one camera differs that is named
_SEVERAL = 3  # captures in a row that may be those after a change
_CLEAR, _CLEAR_PX = 7.0, 0.4  # standard deviations and pixels of a change of the relative pose
_NAMED = 5  # captures in a sentence
_ROUNDS = 10  # of reweighting
_UNKNOWN = 3.0  # captures


@dataclass(frozen=True, eq=False)
class RigCamera:
    """What is asked of a camera here: its name, the poses of its views, and its focal length in pixels."""

    name: str
    poses: CameraPoses
    focal: float


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
    for (a, b), known in sorted(links.items()):
        pair = _Pair(cameras[a], cameras[b], board, known)
        if len(known.captures) >= _SEVERAL:
            pair.require_order()
        found, wrong = pair.of_captures(captures)
        warnings += found
        for capture in wrong:
            for camera in (a, b):
                excluded[capture, camera] = excluded.get((capture, camera), 0) + 1
        failures += pair.changes(captures, wrong)
    warnings += _sides(cameras, links)
    # where several cameras saw a capture, the one at fault does not fit any of the others
    worst = {capture: max(count for (own, _), count in excluded.items() if own == capture) for capture, _ in excluded}
    chosen = frozenset(key for key, count in excluded.items() if count == worst[key[0]])
    return Mistakes(tuple(_once(warnings)), tuple(_once(failures)), chosen)


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
        """Raise InsufficientData if all captures fit another way of putting them together much better, or most of them
        do not fit at all.
        """
        a, b = self.a.poses, self.b.poses
        typical = max(self.typical(self.known, a, b), _LEAST_PX)
        for shift in _SHIFTS:
            moved = replace(b, captures=b.captures + shift)
            found = link(a, moved, self.board)
            enough = found is not None and len(found.captures) >= max(_SEVERAL, len(self.known.captures) // 2)
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
        errors = self.errors(*self.common(), self.known)
        fitting = errors < max(_FAR * float(np.quantile(errors, 0.2)), _FAR_PX)
        if 2 * fitting.sum() <= len(errors):
            text = (
                f"captures of {self.a.name} and {self.b.name} do not belong together: {np.sum(~fitting)} of "
                f"{len(errors)} do not fit the relative pose of the others, by {np.median(errors[~fitting]):.2g} px"
            )
            raise _refused("inconsistent_captures", text, {"captures": int(np.sum(~fitting))})

    def common(self) -> tuple[CameraPoses, CameraPoses]:
        """Return the poses of both cameras in their common captures."""
        rows_a, rows_b = self.rows()
        return _some(self.a.poses, rows_a), _some(self.b.poses, rows_b)

    def _mirrorings(
        self, a: CameraPoses, b: CameraPoses
    ) -> Iterator[tuple[RigCamera, tuple[CameraPoses, CameraPoses]]]:
        """Yield the camera whose images may be mirrored, and the poses as they would be without."""
        for own in _mirrored(b, self.board):
            yield self.b, (a, own)
        for own in _mirrored(a, self.board):
            yield self.a, (own, b)

    def _require_size(self) -> None:
        """Raise InsufficientData if the board is of another size in the images of b."""
        a, b = self.common()
        turns = b.rotations @ a.rotations.transpose(0, 2, 1)
        away = np.linalg.norm(so3.log(turns[:, None] @ turns.transpose(0, 2, 1)), axis=2)
        turn = turns[int(np.argmin(np.median(away, axis=1)))]  # sizes do not change rotations
        centre = outline(self.board)[-1]
        seen = (a.rotations @ centre + a.translations) @ turn.T
        found = _scale(seen, b.rotations @ centre + b.translations)
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

    def of_captures(self, captures: Sequence[str]) -> tuple[list[Message], list[int]]:
        """Return warnings about the captures that do not fit, and which they are."""
        a, b = self.common()
        errors = self.errors(a, b, self.known)
        limit = max(_FAR * float(np.median(errors)), _FAR_PX)
        wrong = np.flatnonzero(errors > limit)
        if not len(wrong) or 2 * len(wrong) > len(errors):
            return [], []
        if self._is_change(wrong, len(errors)):
            return [], []
        result, left = [], wrong.tolist()
        for one in wrong.tolist():
            for other in wrong.tolist():
                if one < other and {one, other} <= set(left):
                    crossed = self.errors(_some(a, [one, other]), _some(b, [other, one]), self.known)
                    if (crossed < np.maximum(_BETTER * errors[[one, other]], limit / _FAR)).all():
                        names = [captures[self.known.captures[each]] for each in (one, other)]
                        text = (
                            f"images of {self.a.name} or {self.b.name} exchanged between captures {' and '.join(names)}"
                        )
                        result.append(Message("exchanged_images", text, {"captures": tuple(names)}))
                        left = [each for each in left if each not in (one, other)]
        for one in list(left):
            how = self._explanation(_some(a, [one]), _some(b, [one]), _BETTER * float(errors[one]))
            if how:
                name = captures[self.known.captures[one]]
                result.append(Message(how[0], f"capture {name}: {how[1]}", {"capture": name}))
                left.remove(one)
        if left:
            names = [captures[self.known.captures[one]] for one in left]
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            text = (
                f"{counted(len(left), 'capture')} of {self.a.name} and {self.b.name} inconsistent with the others, by "
                f"{np.median(errors[left]):.2g} px: {', '.join(names[:_NAMED])}{more}; not used"
            )
            result.append(Message("inconsistent_captures", text, {"captures": tuple(names)}))
        return result, [int(self.known.captures[one]) for one in wrong]

    def _explanation(self, a: CameraPoses, b: CameraPoses, limit: float) -> tuple[str, str] | None:
        """Return the code and the words of what makes one capture fit best, None if nothing brings it below a limit."""
        swapped = float(self.errors(b, a, self.known)[0]), "swapped_images", "swapped"
        tried = [
            (float(self.errors(*pair, self.known)[0]), "mirrored_images", f"{camera.name} mirrored")
            for camera, pair in self._mirrorings(a, b)
        ]
        error, code, words = min([swapped, *tried])
        if error > limit:
            return None
        both = f"{self.a.name} and {self.b.name} swapped"
        return code, f"images of {both}" if words == "swapped" else f"image of {words}"

    def _is_change(self, wrong: Array, count: int) -> bool:
        """Return whether the captures that do not fit are all those before or after one of them."""
        together = len(wrong) >= _SEVERAL and int(wrong[-1] - wrong[0]) == len(wrong) - 1
        return together and (wrong[0] == 0 or wrong[-1] == count - 1)

    def changes(self, captures: Sequence[str], excluded: Sequence[int]) -> list[Message]:
        """Return the message about a relative pose that changed from one capture on."""
        rows_a, rows_b = self.rows()
        used = ~np.isin(self.known.captures, excluded)
        a, b = _some(self.a.poses, rows_a[used]), _some(self.b.poses, rows_b[used])
        numbers = self.known.captures[used]
        if len(numbers) < 2 * _SEVERAL:
            return []
        beside = self.offsets(a, b, self.known)[:, -1]  # of the board's centre
        place, size, clear = _step(beside)
        if clear < _CLEAR or size < _CLEAR_PX:
            return []
        shifted = self._shift_from(numbers, place)
        name, later = captures[numbers[place]], f"from capture {captures[numbers[place]]} on"
        if shifted:
            text = (
                f"captures of {self.a.name} and {self.b.name} are shifted by {counted(abs(shifted), 'capture')} "
                f"{later}: check for a missing image, or use --match"
            )
            return [Message("shifted_captures", text, {"capture": name, "captures": shifted})]
        text = (
            f"relative pose of {self.a.name} and {self.b.name} changed {later}, by {size:.2g} px: "
            "calibrate the captures before and after it separately"
        )
        return [Message("rig_changed", text, {"capture": name, "px": size})]

    def _shift_from(self, numbers: Array, place: int) -> int:
        """Return by how many captures b is shifted from a place on, or up to it; 0 if that does not explain it."""
        for part, rest in ((numbers[place:], numbers[:place]), (numbers[:place], numbers[place:])):
            if len(rest) < _SEVERAL:
                continue
            a, b = self.a.poses, self.b.poses
            whole = link(_of(a, rest), _of(b, rest), self.board)
            if whole is None:
                continue
            before = self.typical(whole, _of(a, part), _of(b, part))
            for shift in _SHIFTS:
                moved = replace(b, captures=b.captures + shift)
                common = np.intersect1d(part, moved.captures)
                if 2 * len(common) < len(part):
                    continue
                after = self.typical(whole, _of(a, common), _of(moved, common))
                if after < max(_BETTER * before, _LEAST_PX) and after < before / 2:
                    return shift
        return 0


def _unit(points: Array) -> Array:
    return np.asarray(points / np.maximum(np.linalg.norm(points, axis=-1, keepdims=True), 1e-300))


def _some(poses: CameraPoses, rows: Array | Sequence[int]) -> CameraPoses:
    index = np.asarray(rows, np.intp)
    return CameraPoses(poses.captures[index], poses.rotations[index], poses.translations[index])


def _of(poses: CameraPoses, captures: Array) -> CameraPoses:
    """Return the views of some captures."""
    return _some(poses, np.flatnonzero(np.isin(poses.captures, captures)))


def _mirrored(poses: CameraPoses, board: Board) -> Iterator[CameraPoses]:
    """Yield the poses of views of mirrored images as they would be without mirroring: the image is mirrored left to
    right, and the detector numbers the columns of the board the other way, or its rows.
    """
    image = np.diag([-1.0, 1.0, 1.0])
    width, height = board.extent
    for own, end in ((np.diag([-1.0, 1.0, 1.0]), [width, 0.0, 0.0]), (np.diag([1.0, -1.0, 1.0]), [0.0, height, 0.0])):
        shift = poses.rotations @ np.array(end)
        yield CameraPoses(poses.captures, image @ poses.rotations @ own, (poses.translations + shift) @ image)


def _scale(seen: Array, there: Array) -> tuple[float, float, float] | None:
    """Return the scale s under which s · there (n, 3) is a shift away from `seen`, and the typical distance of what is
    left without the scale and with it; None where that is undetermined.
    """
    weights, scale, left = np.ones(len(seen)), 1.0, []
    for free in (False, True):
        for _ in range(_ROUNDS):
            share = weights / weights.sum()
            one, other = seen - share @ seen, there - share @ there
            spread = float(share @ np.sum(other**2, axis=1))
            if spread < 1e-6 * float(share @ np.sum(there**2, axis=1)):
                return None
            scale = float(share @ np.sum(one * other, axis=1)) / spread if free else 1.0
            distances = np.linalg.norm(one - scale * other, axis=1)
            weights = 1 / (1 + (distances / max(3 * float(np.median(distances)), 1e-12)) ** 2)
        left.append(float(np.median(distances)))
    return (scale, left[0], left[1]) if scale > 0 else None


def _step(values: Array) -> tuple[int, float, float]:
    """Return the place of the largest step in a series (n, D), its size, and how clear it is, in standard deviations of
    what is left beside it.
    """
    count, best = len(values), (0, 0.0, 0.0)
    if count < 2 * _SEVERAL:
        return best
    for place in range(_SEVERAL, count - _SEVERAL + 1):
        before, after = values[:place], values[place:]
        means = np.median(before, axis=0), np.median(after, axis=0)
        left = np.concatenate([before - means[0], after - means[1]])
        noise = float(np.sqrt(np.mean(np.median(np.abs(left), axis=0) ** 2))) / 0.6745
        size = float(np.linalg.norm(means[1] - means[0]))
        few = 1 + _UNKNOWN / min(place, count - place)  # the noise of few captures is not known well
        clear = size / max(few * noise * np.sqrt(np.pi / 2 * (1 / place + 1 / (count - place))), 1e-12)
        if clear > best[2]:
            best = (place, size, clear)
    return best


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
                result.append(Message("swapped_cameras", text, {}))
    return result


def _refused(code: str, text: str, values: Mapping[str, float]) -> InsufficientData:
    return InsufficientData(text, failures=[Message(code, text, values)])
