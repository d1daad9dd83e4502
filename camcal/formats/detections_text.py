"""Detections as the text of a CSV file; `detections` says what it holds, and reads it."""

from collections.abc import Iterator
from dataclasses import replace

from camcal.cameras.validity import ImageCircle
from camcal.formats.boards import short_form
from camcal.formats.tables import COVARIANCE, cell
from camcal.targets.board import Board
from camcal.targets.board_set import BoardSet
from camcal.targets.detection import BoardDetection, Detections

MAGIC = "# camcal-detections"
VERSION = "1"
NONE = "# none "
CIRCLE = "# image_circle "
COLUMNS = ("image", "width", "height", "id", "u", "v")
OPTIONAL = ("camera", "board", "orientation", *COVARIANCE)


def csv_text(detections: Detections) -> str:
    """Return the text of a CSV file, without empty columns."""
    views = detections.views
    cameras = any(view.camera for view in views)
    turned = any(view.orientation != 1 for view in views)
    measured = any(view.covariance is not None for view in views)
    board = detections.board if isinstance(detections.board, BoardSet) else None
    several = ["board"] if board else []
    names = [*COLUMNS, *["camera"] * cameras, *several, *["orientation"] * turned, *(COVARIANCE if measured else ())]
    circles = [_circle_line(camera, circle) for camera, circle in detections.circles.items()]
    lines = [_first_line(detections.board), *circles, ",".join(names)]
    for view in views:
        tail = f",{cell(view.camera)}" * cameras + f",{view.body}" * len(several) + f",{view.orientation}" * turned
        if board and view.found:
            view = board.alone(view)  # noqa: PLW2901 - with the ids of its own board
        lines += _rows(view, tail, measured=measured) if view.found else [_none_line(view)]
    return "\n".join(lines) + "\n"


def _first_line(board: Board | None) -> str:
    if board is None:
        return f"{MAGIC} {VERSION}"
    words = [MAGIC, VERSION]
    for name, own in board.members.items():
        mark = f":{name}" if name else ""
        words.append(f"board{mark}={short_form(replace(own, first_marker=0))}")
        words += [f"first_marker_id{mark}={own.first_marker}"] if own.first_marker else []
    return " ".join(words)


def _circle_line(camera: str, circle: ImageCircle) -> str:
    numbers = ",".join(map(repr, (*circle.image_size, *circle.centre, circle.radius)))
    return CIRCLE + numbers + (f",{cell(camera)}" if camera else "")


def _rows(view: BoardDetection, tail: str, *, measured: bool) -> Iterator[str]:
    start = f"{cell(view.image)},{view.size[0]},{view.size[1]}"
    points = [f"{start},{i},{u!r},{v!r}{tail}" for i, (u, v) in zip(view.ids, view.pixels.tolist(), strict=True)]
    if not measured:
        return iter(points)
    if view.covariance is None:
        return (f"{point},,," for point in points)
    parts = view.covariance[:, [0, 0, 1], [0, 1, 1]].tolist()
    return (f"{point},{suu!r},{suv!r},{svv!r}" for point, (suu, suv, svv) in zip(points, parts, strict=True))


def _none_line(view: BoardDetection) -> str:
    reason = " ".join((view.reason or "nothing found").split())
    cells = [cell(view.image), str(view.size[0]), str(view.size[1]), cell(reason)]
    if view.camera or view.orientation != 1:
        cells.append(cell(view.camera))
    if view.orientation != 1:
        cells.append(str(view.orientation))
    return NONE + ",".join(cells)
