"""Search for an unknown ChArUco board: marker size, dictionary and number of squares.

The checker pattern says where the squares are. The white margin around a marker says how large it is. Its bits are
looked up in every dictionary. Ids then say how many squares a row has: down two rows they grow by just that number, and
each marker names its place. All of it must agree, so that what is no ChArUco board is not taken for one.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from statistics import median

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput
from camcal.targets.board import CHARUCO, LARGEST, Board
from camcal.targets.checker.charuco import (
    TURNS,
    WHITE,
    WRONG_BITS,
    arrangements,
    bright_squares,
    cells,
    ends_after,
    find_charuco,
    in_squares,
    nearest,
    read_bits,
    rows_seen,
)
from camcal.targets.checker.checker import Checker, trimmed, verified_corners
from camcal.targets.checker.proposals import proposals
from camcal.targets.pattern import family_named

# The largest of each family: the smaller ones of OpenCV are its first markers
_SIZES = (50, 100, 250, 1000)
_DICTIONARIES = (
    *(f"DICT_{bits}X{bits}_{_SIZES[-1]}" for bits in (4, 5, 6, 7)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    *(f"DICT_APRILTAG_{name}" for name in ("16h5", "25h9", "36h10", "36h11")),
)
_CLEARANCE = 0.06  # squares; an edge of a checker pattern whose markers may have any size
_HALF_SIDES = np.linspace(0.12, 0.495, 76)  # squares, of the rings that a marker is measured by
_ALONG = np.linspace(-0.9, 0.9, 13)  # of a half side
_CLEAR = 0.5  # of dark to bright: how much brighter the margin is than the border
_LEAST_VOTES = 4  # markers that agree; two are enough where the board is known
_LEAST_SHARE = 0.6  # of the squares with a dark border, that agree
_RUNNER_UP = 0.5  # of the votes, that the next best reading may have
_SAME_RATIO = 0.06  # of a square: markers that are read with the size of one another
_DIGITS = 2  # of a proposed length
_LEAST_ROWS = 3  # of squares; a board of two has one row of corners


@dataclass(frozen=True)
class CharucoLayout:
    """A ChArUco board as estimated from its image, of columns × rows squares.

    dictionary: the largest one of the family. first: the first marker's id. offset: whether the first square has a
    marker. ratio: side of a marker over that of a square. votes: how many markers agree on
    all of this.
    """

    dictionary: str
    columns: int
    rows: int
    first: int
    offset: bool
    ratio: float
    votes: int

    @property
    def kind(self) -> tuple[str, int, int, bool, int]:
        """Dictionary, columns, first id, offset and rows: what another image of the same board shows as well."""
        return self.dictionary, self.columns, self.first, self.offset, self.rows

    def board(self, like: Board) -> Board:
        """Return the board, with the square of `like`, and its dictionary and its marker where these fit as well."""
        ratio = (like.marker or 0.0) / like.spacing
        marker = like.marker
        if abs(ratio - self.ratio) > _SAME_RATIO:  # in the unit of the board, rounded by its uncertainty
            side = 1e3 * self.ratio * like.spacing
            marker = round(self.ratio, 2) if like.square is None else float(f"{side:.{_DIGITS}g}") / 1e3
        plain = like.legacy is None or self.rows % 2
        return Board(
            CHARUCO,
            self.columns - 1,
            rows=self.rows - 1,
            square=like.square,
            marker=marker,
            dictionary=self._dictionary(like.dictionary or ""),
            first_marker=self.first,
            legacy=None if plain else self.offset,
        )

    def _dictionary(self, liked: str) -> str:
        """Return `liked` if it has the board's markers, else the smallest dictionary that has."""
        least = self.first + self.columns * self.rows // 2
        family = self.dictionary.removesuffix(str(_SIZES[-1]))
        if family == self.dictionary:
            return self.dictionary
        if liked.startswith(family) and family_named(liked).count >= least:
            return liked
        return f"{family}{next((size for size in _SIZES if size >= least), _SIZES[-1])}"


def search_charuco(gray: Array, like: Board) -> CharucoLayout | None:
    """Return the ChArUco board that `gray`, (H, W) uint8, shows most clearly, None where it shows none.

    One that is printed white on black is searched for where there is no other. like: the board that was expected; where
    ids leave a choice its first marker is taken.
    """
    return _clearest(gray, like) or _clearest(np.asarray(WHITE - gray), like)


def _clearest(gray: Array, like: Board) -> CharucoLayout | None:
    """Return the board of dark markers on white that an image shows most clearly."""
    for copy in proposals(gray):
        parts = [layouts for start in copy if (layouts := _layouts(gray, start, like.first_marker))]
        best = max(parts, key=lambda layouts: layouts[0].votes, default=())
        verified = [pair for layout in best if (pair := _verify(gray, layout, like))]
        if verified:
            return max(verified, key=lambda pair: (pair[0], is_like(pair[1], like)))[1]
    return None


def _layouts(gray: Array, start: Array, first: int) -> Sequence[CharucoLayout]:
    """Return the boards that a proposed pattern may be part of by its markers, none if these are too few or at odds.

    They are of one dictionary and have the same votes: one, or two where a column out of sight leaves a choice.
    """
    checker = trimmed(verified_corners(gray, start, _CLEARANCE))
    square, corners = bright_squares(checker)
    ratio = _marker_ratio(gray, corners, checker.contrast)
    if ratio is None:
        return ()
    readings = list(_readings(gray, checker, square, corners, ratio, first))
    readings.sort(key=lambda layouts: -layouts[0].votes)
    unique = readings and (len(readings) == 1 or readings[1][0].votes <= _RUNNER_UP * readings[0][0].votes)
    return readings[0] if unique else ()


def _marker_ratio(gray: Array, corners: Array, contrast: float) -> float | None:
    """Return the side of the markers in squares by where their black borders end, None where there are no markers.

    corners: (4, S, 2) of bright squares. contrast: half of bright minus dark, gray levels.
    """
    if not corners.shape[1]:
        return None
    ring = np.concatenate([np.stack([_ALONG, np.full_like(_ALONG, side)]) for side in (-1.0, 1.0)], axis=1)
    ring = np.concatenate([ring, ring[::-1]], axis=1)
    u, v = (0.5 + np.multiply.outer(_HALF_SIDES, axis).ravel() for axis in ring)
    levels = in_squares(gray, corners, u, v).reshape(corners.shape[1], len(_HALF_SIDES), -1).mean(axis=2)
    profile = np.median(levels, axis=0)
    margin = int(np.argmax(np.where(_HALF_SIDES > 0.2, profile, -np.inf)))
    border = int(np.argmin(profile[: margin + 1]))
    rise = profile[margin] - profile[border]
    if not rise > 2 * _CLEAR * contrast:
        return None
    between = profile[border : margin + 1]
    after = border + int(np.argmax(between > profile[border] + rise / 2))
    part = (profile[border] + rise / 2 - profile[after - 1]) / (profile[after] - profile[after - 1])
    return float(2 * (_HALF_SIDES[after - 1] + part * (_HALF_SIDES[1] - _HALF_SIDES[0])))


def _readings(
    gray: Array, checker: Checker, square: Array, corners: Array, ratio: float, first: int
) -> Iterator[list[CharucoLayout]]:
    """Yield the layouts of most votes by every dictionary that has one; square, corners: see `bright_squares`."""
    by_bits: dict[int, list[str]] = {}
    for name in _DICTIONARIES:
        by_bits.setdefault(family_named(name).bits, []).append(name)
    for bits, names in by_bits.items():
        seen, clear = read_bits(gray, corners, ratio, bits + 2, checker.contrast)
        for name in names if clear.sum() >= _LEAST_VOTES else ():
            words = cells(name, 0, family_named(name).count)[:, 1:-1, 1:-1]
            marker, turn, wrong = nearest(seen[clear], words)
            legible = wrong * WRONG_BITS <= bits * bits
            least = max(_LEAST_VOTES, _LEAST_SHARE * int(clear.sum()))
            layouts: list[CharucoLayout] = []
            for quarters, rotation in enumerate(map(np.array, TURNS)):
                same = legible & (turn == quarters)
                if same.sum() >= _LEAST_VOTES:
                    # around each of the pattern's corners there are four squares
                    ends = np.sort((np.array([(0, 0), checker.found.shape]) - 0.5) @ rotation.T, axis=0)
                    height, width = np.rint(ends[1] - ends[0] + 1).astype(int).tolist()
                    place = np.rint((square[clear][same] - 0.5) @ rotation.T - ends[0]).astype(np.intp)
                    layouts += _agree(place, marker[same], (height, width), name, ratio, first)
            most = max((layout.votes for layout in layouts), default=0)
            if most >= least:
                yield [layout for layout in dict.fromkeys(layouts) if layout.votes == most]


def _agree(
    place: Array, marker: Array, size: tuple[int, int], name: str, ratio: float, first: int
) -> Iterator[CharucoLayout]:
    """Yield the layouts that markers (M,) agree on, each in the row and column place (M, 2) of a part of a board.

    size: rows and columns of squares of the part. Squares of the board are numbered n row by row, and the marker of
    square n is first + n // 2; so 2 · marker - columns · row - column is the same for all of them, or less by one.
    """
    (height, width), (row, column) = size, place.T
    votes: list[tuple[int, int, int]] = []
    for columns in range(max(width, 3), LARGEST if len(marker) else 0):
        counts = Counter((2 * marker - columns * row - column).tolist())
        start = max(counts, key=lambda value: (counts[value] + counts[value - 1], value))
        votes.append((counts[start] + counts[start - 1], columns, start))
    most = max((vote for vote, _, _ in votes), default=0)
    for vote, columns, start in votes:
        if vote < most:
            continue
        for origin in (start, start + 1):  # 2 · first + the number of the part's first square
            for begin in dict.fromkeys((first, 0, origin // 2)):
                top, left = divmod(origin - 2 * begin, columns)
                if min(begin, top) < 0 or left + width > columns or (begin not in (first, 0) and width < columns):
                    continue
                number = (top + row) * columns + left + column
                odd = (top + row + left + column) % 2 == 1
                agree = int(((marker == begin + number // 2) & odd).sum())
                offset = int(((marker == begin + number // 2) & ~odd).sum())
                rows = top + height
                rows += int(offset > agree and rows % 2)  # such a board has an even number of rows
                yield CharucoLayout(
                    name, columns, rows=rows, first=begin, offset=offset > agree, ratio=ratio, votes=max(agree, offset)
                )


def _verify(gray: Array, layout: CharucoLayout, like: Board) -> tuple[int, CharucoLayout] | None:
    """Return the number of corners seen, and the layout with as many rows as they tell of; None if there are none.

    The board is searched for with more rows than its markers tell of, since something may hide what lies between. The
    number of rows is that of `like` where nothing speaks against it.
    """
    for rows in (2 * layout.rows, layout.rows):
        with suppress(InvalidInput):  # too large, or a dictionary without so many markers
            board = replace(replace(layout, rows=rows).board(like), legacy=layout.offset)
            seen = find_charuco(gray, board)
            if not seen.found:
                return None
            least = rows_seen(board, seen.ids)
            if not ends_after(gray, board, least, seen.ids, seen.pixels):
                stated = [each.rows + 1 for each in arrangements(like) if each.columns == board.columns]
                least = max([least, *(count for count in stated if not (layout.offset and count % 2))])
            return (len(seen.ids), replace(layout, rows=least)) if least >= _LEAST_ROWS else None
    return None


def is_like(layout: CharucoLayout, board: Board) -> bool:
    """Return whether a layout is what a board may stand for, but for a marker that is read alike."""
    proposed = layout.board(board)
    return any(
        replace(each, legacy=each.legacy if proposed.legacy is not None else None) == proposed
        for each in arrangements(board)
    )


def common_layout(layouts: Sequence[CharucoLayout]) -> CharucoLayout | None:
    """Return the board that most layouts tell of: as large as it was seen, with the median of the markers' sizes."""
    kinds = Counter(each.kind[:-1] for each in layouts)
    if not kinds:
        return None
    kind = max(kinds, key=lambda key: kinds[key])
    same = [each for each in layouts if each.kind[:-1] == kind]
    most = max(each.rows for each in same)
    return replace(same[0], rows=most, ratio=median(each.ratio for each in same))
