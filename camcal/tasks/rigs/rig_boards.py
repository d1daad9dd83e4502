"""The boards of `camcal rig`: which there are, which of them are joined, and what is known of them beforehand."""

import re
from collections.abc import Iterator, Sequence

import numpy as np

from camcal.calibrate.rigs.measured import KnownDistance, KnownRelation, Measured
from camcal.errors import InvalidInput
from camcal.formats import boards, frames
from camcal.parsing import did_you_mean, parse_number
from camcal.targets.board import Board
from camcal.targets.board_set import BoardSet, board_set
from camcal.targets.board_types import METRES
from camcal.tasks.rigs.camera_inputs import require_name
from camcal.tasks.rigs.options import RigSettings, named_board

_NONE = "none"
_DISTANCE = re.compile(r"(?P<a>[^:=]+):(?P<b>[^:=]+)=(?P<length>[^±]+?)(±|\+-|\+/-)(?P<std>.+)")
_FORM = "such as 0:53=0.25m±0.1mm, or a.0:b.12=1.503m±2mm of several boards"


def asked_board(settings: RigSettings) -> Board | None:
    """Return the board that settings ask for, several as one, None where they leave it to a detections file.

    Raises InvalidInput for names that are missing, not valid or given twice.
    """
    given = settings.board if isinstance(settings.board, tuple) else (settings.board,) if settings.board else ()
    named = [named_board(each) if isinstance(each, str) else ("", each) for each in given]
    if not named:
        return None
    found: dict[str, Board] = {}
    for name, each in named:
        if len(named) > 1 and not name:
            raise InvalidInput("several boards need names: --board a=BOARD --board b=BOARD")
        if name:
            require_name(name, "board")
        if name in found:
            raise InvalidInput(f"--board: the name {name!r} is given twice")
        found[name] = boards.load_board(each) if isinstance(each, str) else each
    if len(found) == 1:
        [board] = found.values()
        for name in board.members if isinstance(board, BoardSet) else ():
            require_name(name, "board")
        return board
    if (inside := next((name for name, each in found.items() if isinstance(each, BoardSet)), None)) is not None:
        raise InvalidInput(f"--board {inside}: the file has several boards; give it alone")
    return board_set(found)


def require_other_names(board: Board, cameras: Sequence[str]) -> None:
    """Raise InvalidInput for a board that has the name of a camera: transforms would not tell them apart."""
    same = next((name for name in board.members if name in cameras), None)
    if same is not None:
        raise InvalidInput(f"--board: {same!r} is the name of a camera as well; use another one")


def bodies_of(settings: RigSettings, board: Board) -> tuple[tuple[str, ...], ...] | None:
    """Return the groups of boards that are joined, None where all of them are."""
    names = list(board.members)
    if not settings.joined or settings.joined == (_NONE,):
        return () if settings.joined else None
    groups = [tuple(each.split(",")) for each in settings.joined]
    every = [name for group in groups for name in group]
    for name in every:
        if name not in names:
            raise InvalidInput(f"--joined: no board {name!r}{did_you_mean(name, names)}")
        if every.count(name) > 1:
            raise InvalidInput(f"--joined: board {name!r} is named twice; name all that are joined in one group")
    return tuple(groups)


def measured_of(settings: RigSettings, board: Board) -> Measured:
    """Return what is known of boards beforehand; raises InvalidInput, FileError."""
    names, groups = list(board.members), bodies_of(settings, board)
    bodies = groups if groups is not None else (tuple(names),)
    distances = tuple(_distance(text, board, bodies) for text in settings.distances)
    return Measured(tuple(_relations(settings, names, bodies)), distances)


def _relations(settings: RigSettings, names: Sequence[str], bodies: Sequence[Sequence[str]]) -> Iterator[KnownRelation]:
    if settings.relations is None:
        return
    found = False
    for each in frames.read(settings.relations):
        if each.target not in names or each.source not in names:
            continue
        if not any({each.target, each.source} <= set(body) for body in bodies):
            raise InvalidInput(f"{each.name}: the boards are not joined, see --joined", where=each.where)
        if each.covariance is None:
            raise InvalidInput(f"{each.name}: has no covariance and no std", where=each.where)
        # a relation that is exact in some direction holds it to a micrometre and a microradian
        covariance = np.asarray(each.covariance) + 1e-12 * np.eye(6)
        yield KnownRelation(names.index(each.target), names.index(each.source), each.pose, covariance)
        found = True
    if not found:
        pairs = f"{names[0]}_T_{names[1]}" if len(names) > 1 else "a_T_b"
        raise InvalidInput(
            f"has no transform between two of the boards, such as {pairs}", where=str(settings.relations)
        )


def _distance(text: str, board: Board, bodies: Sequence[Sequence[str]]) -> KnownDistance:
    match = _DISTANCE.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InvalidInput(f"--distance {text}: is not of the form POINT:POINT=LENGTH±STD, {_FORM}")
    (point_a, board_a), (point_b, board_b) = (_point(match[end], text, board) for end in "ab")
    metres, std = (_metres(match[part], text) for part in ("length", "std"))
    if point_a == point_b or metres <= 0 or std <= 0:
        raise InvalidInput(f"--distance {text}: needs two points, and a positive length and standard deviation")
    names = list(board.members)
    if board_a != board_b and not any({names[board_a], names[board_b]} <= set(body) for body in bodies):
        raise InvalidInput(f"--distance {text}: the boards are not joined, see --joined")
    return KnownDistance((point_a, point_b), (board_a, board_b), metres, std, text)


def _point(text: str, whole: str, board: Board) -> tuple[int, int]:
    """Return the number of a point among those of all boards, and the place of its board."""
    name, dot, number = text.rpartition(".")
    names = list(board.members)
    several = isinstance(board, BoardSet)
    if several and name not in names:
        known = f"a board is missing before its number, {_FORM}" if not dot else f"no board {name!r}"
        raise InvalidInput(f"--distance {whole}: {known}{did_you_mean(name, names) if dot else ''}")
    if not several and dot:
        raise InvalidInput(f"--distance {whole}: there is one board, which has no name here: {number}")
    place = names.index(name) if several else 0
    count = list(board.members.values())[place].count
    if not number.isdecimal() or int(number) >= count:
        whose = f"board {name}" if several else "the board"
        raise InvalidInput(f"--distance {whole}: no point {number!r}: {whose} has the points 0 to {count - 1}")
    return int(number) + (board.starts[place] if isinstance(board, BoardSet) else 0), place


def _metres(text: str, whole: str) -> float:
    for unit in sorted(METRES, key=len, reverse=True):
        if text.endswith(unit):
            try:
                return parse_number(text.removesuffix(unit)) * METRES[unit]
            except ValueError:
                break
    raise InvalidInput(f"--distance {whole}: {text!r} is not a length with its unit, {', '.join(METRES)}")


def require_size(board: Board) -> None:
    """Raise InvalidInput for a board without a metric size: distances between cameras would have no scale."""
    if board.unit != "m":
        raise InvalidInput(
            f"a {board.words} of unknown size gives no distances between cameras: give it in --board, such as "
            "chessboard:9x6:25mm"
        )
