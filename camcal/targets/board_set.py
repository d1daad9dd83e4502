"""Several boards as one: their points numbered one after another, each in the frame of its own board.

A view is of one of them, wherever it stands against the others; so a camera is calibrated from views of all of them as
it is from those of one board.
"""

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray
from camcal.dataclass import dataclass, field, replace
from camcal.errors import InvalidInput
from camcal.targets.board import Board, Surface, bare_term, basis
from camcal.targets.board_types import APRILGRID, CHARUCO, unchanged
from camcal.targets.detection import BoardDetection


@dataclass(frozen=True)
class BoardSet(Board):
    """Boards with names, two or more; its own fields are those of the first one."""

    names: tuple[str, ...] = ()
    boards: tuple[Board, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        """Nothing is left to check: its boards have checked themselves, and `board_set` what they are together."""

    @property
    def members(self) -> Mapping[str, Board]:
        """The boards by their names, in the order of their points."""
        return dict(zip(self.names, self.boards, strict=True))

    @property
    def has_ids(self) -> bool:
        """Whether every point of a part of a board can be distinguished from the others."""
        return all(board.has_ids for board in self.boards)

    @property
    def has_saddle_corners(self) -> bool:
        """Whether two edges cross at every point."""
        return all(board.has_saddle_corners for board in self.boards)

    @property
    def count(self) -> int:
        """The number of points."""
        return self.starts[-1]

    @property
    def unit(self) -> str:
        """The unit of every length: that of all its boards."""
        return "m" if all(board.unit == "m" for board in self.boards) else "squares"

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """Where the points of each board begin, and where they all end."""
        return tuple(np.cumsum([0, *(board.count for board in self.boards)]).tolist())

    @cached_property
    def extent(self) -> tuple[float, float]:
        """Width and height of what holds each of the boards, in `unit`."""
        width, height = np.max([board.extent for board in self.boards], axis=0).tolist()
        return width, height

    @property
    def words(self) -> str:
        """What the boards are."""
        return ", ".join(f"{name}: {board.words}" for name, board in self.members.items())

    def points(self) -> FloatArray:
        """Return the points (count, 3) in `unit`, each in the frame of its board, as drawn (z = 0)."""
        return np.concatenate([board.points() for board in self.boards])

    def symmetries(self) -> tuple[IntArray, ...]:
        """Return the identity alone: none of the boards looks like itself turned, see `board_set`."""
        return unchanged(self.count)

    def place_of(self, ids: Array) -> Array:
        """Return which of the boards points (N,) are on."""
        return np.asarray(np.searchsorted(self.starts, ids, side="right") - 1)

    def numbered(self, name: str, view: BoardDetection) -> BoardDetection:
        """Return a view of one board with the numbers that its points have among those of all."""
        place = self.names.index(name)
        return replace(view.renumbered(np.arange(self.boards[place].count) + self.starts[place]), body=name)

    def alone(self, view: BoardDetection) -> BoardDetection:
        """Return a view with the numbers that its points have on its own board."""
        place = self.names.index(view.body)
        return view.renumbered(np.arange(self.count) - self.starts[place])


def board_set(boards: Mapping[str, Board]) -> BoardSet:
    """Return boards as one; raises InvalidInput for those that could be taken for others, or for themselves turned.

    A detector that cannot tell which board it sees, or from which end it counts, would tie them to wrong places.
    """
    names = tuple(boards)
    for index, (name, board) in enumerate(boards.items()):
        if len(board.symmetries()) > 1:
            raise InvalidInput(
                f"board {name}: a {board.words} looks the same when it is turned: beside other boards use one with an "
                "odd number of columns plus rows, or with markers"
            )
        for other in names[:index]:
            if _confusable(board, boards[other]):
                raise InvalidInput(
                    f"boards {other} and {name} cannot be told apart: give them different numbers of corners, or "
                    "markers with different ids (first_marker_id, first_tag_id in a board file)"
                )
    first = boards[names[0]]
    own = {each: getattr(first, each) for each in Board.__dataclass_fields__}
    return BoardSet(**own, names=names, boards=tuple(boards.values()))


def _confusable(one: Board, other: Board) -> bool:
    """Return whether an image of a board may show the other one as well."""
    if {one.type, other.type} <= {CHARUCO, APRILGRID}:
        same = (
            one.type == other.type and (one.dictionary or "").split("_")[:2] == (other.dictionary or "").split("_")[:2]
        )
        a, b = (range(own.first_marker, own.first_marker + _markers(own)) for own in (one, other))
        return same and a.start < b.stop and b.start < a.stop
    sizes = [{own.columns, own.rows} for own in (one, other)]
    return one.type == other.type and one.dots == other.dots and sizes[0] == sizes[1]


def _markers(board: Board) -> int:
    if board.type == APRILGRID:
        return board.columns * board.rows
    return (board.columns + 1) * (board.rows + 1) // 2


def surfaces_of(surface: Surface) -> dict[str, Surface]:
    """Return the shape of each of several boards by its name; of one board, its own without a name."""
    board = surface.board
    if not isinstance(board, BoardSet):
        return {"": surface}
    result = {}
    for index, (name, member) in enumerate(board.members.items()):
        own = np.array([place for place, term in enumerate(surface.terms) if term.startswith(f"{name}:")], np.intp)
        rows = slice(*board.starts[index : index + 2])
        offsets = None if surface.offsets is None else surface.offsets[rows]
        terms = tuple(bare_term(surface.terms[place]) for place in own)
        height = basis(member, terms)[:, 2] @ surface.coefficients[own]
        height = height + (0.0 if offsets is None else offsets[:, 2])
        plane = np.column_stack([np.ones(member.count), member.points()[:, :2]])
        left = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
        result[name] = replace(
            surface,
            board=member,
            terms=terms,
            coefficients=surface.coefficients[own],
            covariance=surface.covariance[np.ix_(own, own)],
            offsets=offsets,
            deflection=float(np.ptp(left)),
        )
    return result
