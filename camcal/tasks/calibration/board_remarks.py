"""What is to be said of a board after a set of images was searched for it: remarks, or why there is nothing."""

from collections import Counter
from collections.abc import Sequence

from camcal.errors import InsufficientData
from camcal.targets.board import (
    APRILGRID,
    ASYMMETRIC_CIRCLES,
    CHARUCO,
    CHESSBOARD,
    CIRCLES,
    Board,
    Detection,
)

Size = tuple[int, int]

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


def nothing_found(
    views: Sequence[Detection], patterns: Sequence[Size | None], board: Board, *, parts: bool = False
) -> InsufficientData | None:
    """Return the error that says why the board is in no image, None where it is in some.

    patterns: the checker patterns of another size that images show. One that is larger than the board and in more
    images than the board means that a part of another board was taken for it; a smaller one may be a part of the board,
    which counts only if parts do.
    """
    found = sum(view.found for view in views)
    sizes = Counter(size for size in patterns if size is not None and (not found or _larger(size, board)))
    common = max(sizes, key=lambda size: sizes[size], default=None)
    if found and (common is None or sizes[common] <= found):
        return None
    if board.type != CHESSBOARD or common is None:
        advice = f"check {_TO_CHECK[board.type]}, or look at the images"
        return InsufficientData(f"no {board.words} in any of {len(views)} images{_reasons(views)}; {advice}")
    columns, rows = common if board.columns >= board.rows else common[::-1]
    squares = (columns + 1, rows + 1) == (board.columns, board.rows)
    why = "sizes count inner corners, not squares: " if squares else ""
    dots = ":dots" if board.dots else ""
    hidden = "" if parts or squares or _larger(common, board) else ", or --partial if the rest is out of sight"
    return InsufficientData(
        f"no {board.words} in {len(views) - found} of {len(views)} images, but a checker pattern of {columns}x{rows} "
        f"in {sizes[common]}; {why}use --board chessboard:{columns}x{rows}{dots}{hidden}"
    )


def _larger(size: Size, board: Board) -> bool:
    return size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows)


def _reasons(views: Sequence[Detection]) -> str:
    reason, count = Counter(view.reason for view in views).most_common(1)[0]
    return f" ({count} times: {reason})"


def _squares(board: Board) -> str:
    return f"{board.columns + 1}x{board.rows + 1}"
