"""What is to be said of a board after a set of images was searched for it: remarks, or why there is nothing."""

from collections import Counter
from collections.abc import Sequence

from camcal.errors import InsufficientData
from camcal.targets.board import CHARUCO, Board, Detection

Size = tuple[int, int]


def remarks(views: Sequence[Detection], board: Board, stated: Board) -> tuple[str, ...]:
    """Return what a person should know of a set of views, a line each; board: as found, stated: as asked for."""
    notes = []
    if board.columns != stated.columns:
        notes.append(f"the board has {_squares(board)} squares, not {_squares(stated)}: taken as it is")
    if board.legacy != stated.legacy and (board.rows + 1) % 2 == 0:
        name = "legacy pattern (OpenCV before 4.6)" if board.legacy else "current pattern (OpenCV since 4.6)"
        notes.append(f"the board has the {name}")
    if board.square is None:
        notes.append("the size of a square is not given: lengths are in squares")
    if len(board.symmetries()) > 1:
        turn = "a quarter turn" if board.columns == board.rows else "half a turn"
        notes.append(f"a {board.columns}x{board.rows} board looks the same after {turn}: numbering may differ by views")
    turned = sum(view.orientation != 1 for view in views)
    if turned:
        notes.append(f"the EXIF orientation of {turned} images is noted and not applied")
    return tuple(notes)


def nothing_found(views: Sequence[Detection], patterns: Sequence[Size | None], board: Board) -> InsufficientData | None:
    """Return the error that says why the board is in no image, None where it is in some.

    patterns: the checker patterns of another size that images show. One that is larger than the board and in more
    images than the board means that a part of another board was taken for it.
    """
    found = sum(view.found for view in views)
    sizes = Counter(size for size in patterns if size is not None and (not found or _larger(size, board)))
    common = max(sizes, key=lambda size: sizes[size], default=None)
    if found and (common is None or sizes[common] <= found):
        return None
    if board.type == CHARUCO or common is None:
        return InsufficientData(f"{_missing(board)} in any of {len(views)} images{_reasons(views)}; {_advice(board)}")
    columns, rows = common if board.columns >= board.rows else common[::-1]
    squares = (columns + 1, rows + 1) == (board.columns, board.rows)
    why = "sizes count inner corners, not squares: " if squares else ""
    return InsufficientData(
        f"{_missing(board)} in {len(views) - found} of {len(views)} images, but a checker pattern of {columns}x{rows} "
        f"in {sizes[common]}; {why}use --board chessboard:{columns}x{rows}"
    )


def _larger(size: Size, board: Board) -> bool:
    return size[0] > max(board.columns, board.rows) or size[1] > min(board.columns, board.rows)


def _missing(board: Board) -> str:
    if board.type == CHARUCO:
        return f"no ChArUco board of {_squares(board)} squares"
    return f"no chessboard of {board.columns}x{board.rows} inner corners"


def _reasons(views: Sequence[Detection]) -> str:
    reason, count = Counter(view.reason for view in views).most_common(1)[0]
    return f" ({count} times: {reason})"


def _advice(board: Board) -> str:
    if board.type == CHARUCO:
        return "check squares, dictionary, marker size and first marker, or look at the images"
    return "check the size (inner corners, one less than squares each way), or look at the images"


def _squares(board: Board) -> str:
    return f"{board.columns + 1}x{board.rows + 1}"
