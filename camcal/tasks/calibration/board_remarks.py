"""What is to be said of a board after a set of images was searched for it: remarks, or why there is nothing."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from camcal.errors import InsufficientData
from camcal.formats.boards import short_form
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, CHARUCO, CHESSBOARD, CIRCLES, Board
from camcal.targets.detection import Detection

_UNKNOWN_SIZE = {
    CHESSBOARD: "the size of a square is not given: lengths are in squares",
    CHARUCO: "the size of a square is not given: lengths are in squares",
    APRILGRID: "the size of a tag is not given: lengths are in squares, 1 from tag to tag",
    CIRCLES: "the distance of the circles is not given: lengths are in squares, 1 from circle to circle",
    ASYMMETRIC_CIRCLES: "the distance of the circles is not given: lengths are in squares, 1 from row to row",
}
_TO_CHECK = {
    CHESSBOARD: "the size (inner corners, one less than squares each way)",
    CHARUCO: "squares, dictionary, marker size and first marker",
    APRILGRID: "the number of tags, their family and the first one's id",
    CIRCLES: "the number of circles each way",
    ASYMMETRIC_CIRCLES: "the number of circles (those in one row, then the rows)",
}


def remarks(views: Sequence[Detection], board: Board, stated: Board) -> tuple[str, ...]:
    """Return what a person should know of a set of views, a line each; board: as found, stated: as asked for."""
    notes = []
    if board.columns != stated.columns:
        notes.append(f"the board has {_squares(board)} squares, not {_squares(stated)}: taken as it is")
    if board.legacy != stated.legacy and (board.rows + 1) % 2 == 0:
        name = "legacy pattern (OpenCV before 4.6)" if board.legacy else "current pattern (OpenCV since 4.6)"
        notes.append(f"the board has the {name}")
    if board.square is None:
        notes.append(_UNKNOWN_SIZE[board.type])
    if (looks := len(board.symmetries())) > 1:
        turn = "half a turn" if looks == 2 else "a quarter turn"
        notes.append(f"a {board.columns}x{board.rows} board looks the same after {turn}: numbering may differ by views")
    turned = sum(view.orientation != 1 for view in views)
    if turned:
        notes.append(f"the EXIF orientation of {turned} images is noted and not applied")
    return tuple(notes)


def nothing_found(views: Sequence[Detection], board: Board, *, parts: bool = False) -> InsufficientData | None:
    """Return the error that says why the board is in no image, None where it is in some.

    Images may show other boards instead. One that is larger than the board and in more images than the board means that
    a part of another board was taken for it; a smaller one may be a part of the board, which counts only if parts do.
    """
    found = sum(view.found for view in views)
    others = (view.other for view in views)
    counts = Counter(other for other in others if other is not None and (not found or _larger(other, board)))
    common = max(counts, key=lambda other: counts[other], default=None)
    if found and (common is None or counts[common] <= found):
        return None
    if common is None:
        advice = f"check {_TO_CHECK[board.type]}, or look at the images"
        return InsufficientData(f"no {board.words} in any of {len(views)} images{_reasons(views)}; {advice}")
    squares = (common.columns + 1, common.rows + 1) == (board.columns, board.rows)
    checker = board.type == CHESSBOARD
    why = "sizes count inner corners, not squares: " if checker and squares else ""
    part = not (parts or squares or not checker or _larger(common, board))
    hidden = ", or --partial if the rest is out of sight" if part else ""
    article = "an" if common.type == ASYMMETRIC_CIRCLES else "a"
    what = f"a checker pattern of {common.columns}x{common.rows}" if checker else f"{article} {common.words}"
    return InsufficientData(
        f"no {board.words} in {len(views) - found} of {len(views)} images, but {what} "
        f"in {counts[common]}; {why}use --board {short_form(common)}{hidden}"
    )


@dataclass(frozen=True)
class OtherBoard:
    """A ChArUco board that images show in place of the one that was asked for, in `shown` of `tried` images."""

    board: Board
    shown: int
    tried: int

    def error(self, views: Sequence[Detection], asked: Board) -> InsufficientData:
        """Return the error that says so; views: what was found of the board that was asked for."""
        missing = sum(not view.found for view in views)
        lacking = f"no {asked.words}" + (f" in {missing} of {len(views)} images" if missing else "")
        return InsufficientData(
            f"{lacking}: {self.shown} of {self.tried} images that were tried show "
            f"{', '.join(_differences(self.board, asked))}; use --board {_stated(self.board)}"
        )


def _differences(board: Board, asked: Board) -> list[str]:
    """Return what a ChArUco board has that was not asked for, in words."""
    size = (board.columns, board.rows)
    pairs = [
        (f"{_squares(board)} squares", _squares(asked), size != (asked.columns, asked.rows)),
        (f"{board.dictionary}", f"{asked.dictionary}", board.dictionary != asked.dictionary),
        (f"markers of {_marker(board)}", _marker(asked), board.marker != asked.marker),
        (f"marker ids from {board.first_marker}", f"{asked.first_marker}", board.first_marker != asked.first_marker),
        (_pattern(board), _pattern(asked), board.legacy is not None and board.legacy != asked.legacy),
    ]
    return [f"{has}, not {wanted}" for has, wanted, differs in pairs if differs]


def _marker(board: Board) -> str:
    marker = board.marker or 0.0
    return f"{marker:.3g} of a square" if board.square is None else f"{1e3 * marker:.4g} mm"


def _pattern(board: Board) -> str:
    return "the legacy pattern (OpenCV before 4.6)" if board.legacy else "the current pattern (OpenCV since 4.6)"


def _stated(board: Board) -> str:
    """Return how a board is given to --board; a first marker other than 0 takes a board file."""
    if not board.first_marker:
        return short_form(board)
    form = short_form(replace(board, first_marker=0))
    return f"with a board file: {form}, first_marker_id: {board.first_marker}"


def _larger(other: Board, board: Board) -> bool:
    (long, short), (longest, shortest) = (
        (max(each.columns, each.rows), min(each.columns, each.rows)) for each in (other, board)
    )
    return long > longest or short > shortest


def _reasons(views: Sequence[Detection]) -> str:
    reason, count = Counter(view.reason for view in views).most_common(1)[0]
    return f" ({count} times: {reason})"


def _squares(board: Board) -> str:
    return f"{board.columns + 1}x{board.rows + 1}"
