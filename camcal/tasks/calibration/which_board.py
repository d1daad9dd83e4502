"""What is said of the board that images show, and which one they show where it is not the one that was given."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from camcal import opencv
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData
from camcal.formats.boards import short_form
from camcal.messages import Message, counted
from camcal.raw.options import ImageReadOptions
from camcal.targets.board import APRILGRID, ASYMMETRIC_CIRCLES, CHARUCO, CHESSBOARD, CIRCLES, Board
from camcal.targets.checker.charuco import ends_after, rows_seen
from camcal.targets.checker.charuco_search import CharucoLayout, common_layout, is_like, search_charuco
from camcal.targets.detect import SEED
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.board_search import SAMPLE, Material, gray_of, spread
from camcal.tasks.calibration.video_frames import Frame

_UNKNOWN_SIZE = {
    CHESSBOARD: "square size unknown: lengths are in squares; give it with --board",
    CHARUCO: "square size unknown: lengths are in squares; give it with --board",
    APRILGRID: "tag size unknown: lengths are in tag spacings; give it with --board",
    CIRCLES: "circle spacing unknown: lengths are in spacings; give it with --board",
    ASYMMETRIC_CIRCLES: "circle spacing unknown: lengths are in row spacings; give it with --board",
}
_TO_CHECK = {
    CHESSBOARD: "the size (inner corners, one less than squares each way)",
    CHARUCO: "squares, dictionary, marker size and first marker",
    APRILGRID: "the number of tags, their family and the first one's id",
    CIRCLES: "the number of circles each way",
    ASYMMETRIC_CIRCLES: "the number of circles (those in one row, then the rows)",
}

_SEARCHING = "trying other boards"
_ENDING = 1 / 3  # of the images that are tried, that show where a board ends: in others something may hide it
_OFTEN = 0.5  # of the images, in which a board that is the right one is found


def board_warnings(views: Sequence[BoardDetection], board: Board, stated: Board) -> tuple[Message, ...]:
    """Return the warnings about a board and the views of it; board: as found, stated: as asked for."""
    found = []
    if board.columns != stated.columns:
        text = f"the board has {_squares(board)} squares, not {_squares(stated)}: the found size is used"
        found.append(Message("board_size_differs", text))
    if board.square is None:
        found.append(Message("unknown_board_size", _UNKNOWN_SIZE[board.type]))
    turned = sum(view.orientation != 1 for view in views)
    if turned:
        text = f"EXIF orientation ignored in {counted(turned, 'image')}: pixels are used as stored"
        found.append(Message("orientation_ignored", text, {"images": turned}))
    return tuple(found)


def symmetry_warnings(board: Board) -> tuple[Message, ...]:
    """Return the warning about a symmetric board, for what depends on how its corners are numbered."""
    if (looks := len(board.symmetries())) == 1:
        return ()
    angle = 180 if looks == 2 else 90
    text = (
        f"a {board.columns}x{board.rows} board is symmetric under rotation by {angle}°: corner ids, and poses of the "
        "board, may be turned by that from view to view"
    )
    return (Message("symmetric_board", text, {"rotation_deg": angle}),)


def pattern_lines(board: Board, stated: Board, views: Sequence[BoardDetection]) -> tuple[str, ...]:
    """Return lines on the pattern of a ChArUco board where it was found out, and where a board is printed inverted."""
    count = sum(view.inverted for view in views)
    # a chessboard that is cut at its squares and lies on black looks the same
    how = "with a dark margin, as if printed inverted" if board.type == CHESSBOARD else "printed inverted"
    inverted = (f"board {how}, white on black, in {counted(count, 'image')}",) if count else ()
    return inverted + _pattern_lines(board, stated)


def _pattern_lines(board: Board, stated: Board) -> tuple[str, ...]:
    if board.legacy == stated.legacy or (board.rows + 1) % 2:
        return ()
    return ("legacy ChArUco pattern (OpenCV < 4.6)" if board.legacy else "current ChArUco pattern (OpenCV >= 4.6)",)


def nothing_found(
    views: Sequence[BoardDetection], board: Board, *, parts: bool = False, total: int | None = None
) -> InsufficientData | None:
    """Return the error that says why the board is in no image, None where it is in some; total: the number of images
    where some were not searched.

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
        advice = f"check {_TO_CHECK[board.type]}, and the images"
        if total is not None:
            advice += ", or give only images that show the board"
        searched = min(len(views), SAMPLE)
        instead = f", no other ChArUco board in {searched} of them" if board.type == CHARUCO and searched > 1 else ""
        return InsufficientData(f"no {board.words} in {_any(views, total)}{_reasons(views)}{instead}; {advice}")
    squares = (common.columns + 1, common.rows + 1) == (board.columns, board.rows)
    checker = board.type == CHESSBOARD
    why = "sizes count inner corners, not squares: " if checker and squares else ""
    part = not (parts or squares or not checker or _larger(common, board))
    hidden = ", or --partial if the rest is not visible" if part else ""
    article = "an" if common.type == ASYMMETRIC_CIRCLES else "a"
    what = f"a checker pattern of {common.columns}x{common.rows}" if checker else f"{article} {common.words}"
    return InsufficientData(
        f"no {board.words} in {len(views) - found} of {_images(views, total)}, but {what} "
        f"in {counts[common]}; {why}use --board {short_form(common)}{hidden}"
    )


@dataclass(frozen=True)
class OtherBoard:
    """A ChArUco board that images show in place of the one that was asked for, in `shown` of `tried` images."""

    board: Board
    shown: int
    tried: int

    def error(self, views: Sequence[BoardDetection], asked: Board, total: int | None = None) -> InsufficientData:
        """Return the error that says so; views: what was found of the board that was asked for. total: see
        `nothing_found`.
        """
        missing = sum(not view.found for view in views)
        lacking = f"no {asked.words}" + (f" in {missing} of {_images(views, total)}" if missing else "")
        return InsufficientData(
            f"{lacking}: {self.shown} of {self.tried} tested images show "
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


def _any(views: Sequence[BoardDetection], total: int | None) -> str:
    """Return 'the image', or 'any of 9 images'."""
    return "the image" if len(views) == 1 else f"any of {_images(views, total)}"


def _images(views: Sequence[BoardDetection], total: int | None) -> str:
    return counted(len(views), "image") + ("" if total is None else f" tested of {total}")


def _reasons(views: Sequence[BoardDetection]) -> str:
    reason, count = Counter(view.reason for view in views).most_common(1)[0]
    return f" ({counted(count, 'time')}: {reason})"


def _squares(board: Board) -> str:
    return f"{board.columns + 1}x{board.rows + 1}"


def other_board(asked: Board, board: Board, views: Sequence[BoardDetection], material: Material) -> OtherBoard | None:
    """Return the ChArUco board that images show in place of the one asked for, None if they show no other one.

    board: the arrangement of it that was searched for. views: what was found of it. A board that is found in less than
    half of the images may be a part of one with other columns or more rows; one whose last rows are never seen may end
    before them.
    """
    found = [view for view in views if view.found]
    if len(found) < _OFTEN * len(views):
        other = _search(asked, material.of({view.image for view in found}) if found else material)
        if other is not None and (not found or _holds(other.board, board)):
            return other
    return _with_fewer_rows(asked, board, found, material)


def _holds(other: Board, board: Board) -> bool:
    """Return whether another board has the same kind of markers in other columns or in more rows."""
    return _family(other) == _family(board) and (other.columns != board.columns or other.rows > board.rows)


def _family(board: Board) -> str:
    """Return what the dictionary of a board has in common with those that hold more or fewer of the same markers."""
    return (board.dictionary or "").rpartition("_")[0]


def _search(asked: Board, material: Material) -> OtherBoard | None:
    """Return the board that a few images show, searched for until two of them agree."""
    work = partial(_layout_in, reading=replace(material.reading, colours=False), like=asked)
    tasks = list(material.sample(SAMPLE).sources())
    layouts: list[CharucoLayout] = []
    tried = 0
    for outcome in material.search(work, tasks, _SEARCHING):
        tried += 1
        layouts += [outcome.value] if outcome.value else []
        if len(layouts) > len({layout.kind for layout in layouts}):
            break
    common = common_layout(layouts)
    if common is None or is_like(common, asked):
        return None
    shown = sum(layout.kind[:-1] == common.kind[:-1] for layout in layouts)
    return OtherBoard(common.board(asked), shown, tried)


def _layout_in(task: tuple[str, Path | Frame], reading: ImageReadOptions, like: Board) -> CharucoLayout | None:
    with opencv.repeatable(SEED):
        return search_charuco(gray_of(task[1], reading), like)


def _with_fewer_rows(
    asked: Board, board: Board, found: Sequence[BoardDetection], material: Material
) -> OtherBoard | None:
    """Return the board without the rows that no image shows, None where the images do not show that it ends there."""
    rows = max((rows_seen(board, view.ids) for view in found), default=0)
    if rows in (0, board.rows + 1):
        return None
    views = {view.image: view for view in spread(found, SAMPLE)}
    work = partial(_ends_in, reading=replace(material.reading, colours=False), board=board, rows=rows)
    tasks = [(name, source, views[name]) for name, source in material.of(views).sources()]
    outcomes = list(material.search(work, tasks, _SEARCHING))
    shown = sum(bool(outcome.value) for outcome in outcomes)
    if not shown or shown < _ENDING * len(outcomes):
        return None
    return OtherBoard(replace(board, rows=rows - 1, legacy=None if rows % 2 else asked.legacy), shown, len(outcomes))


def _ends_in(
    task: tuple[str, Path | Frame, BoardDetection], reading: ImageReadOptions, board: Board, rows: int
) -> bool:
    _, source, view = task
    return ends_after(gray_of(source, reading), board, rows, view.ids, view.pixels)
