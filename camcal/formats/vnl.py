"""mrcal's corners.vnl: white-space columns filename, x, y and a level, all corners of the board in order.

Every image has one row per corner, along the board's rows, with '-' for what was not seen, or a single row of '-'.
The level says at which power of two of reduction a corner was found: its standard deviation is 2^level times that of
level 0, which mrcal takes from the residuals. A negative level or coordinate means not seen. A file has neither the
board nor the size of the images; both come from the caller.
Source: mrcal 2.5, mrcal.compute_chessboard_corners.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.formats.tables import Lines, Table, far_outside, numbered_lines
from camcal.targets.board import Board
from camcal.targets.detection import BoardDetection, Detections

SUFFIX = ".vnl"
MISSING = "-"
MAX_LEVEL = 20

ImageSize = tuple[int, int] | Callable[[str], tuple[int, int]]


def read(path: Path, board: Board | None, image_size: ImageSize | None) -> Detections:
    """Return the detections in a corners.vnl; image_size: one (width, height) or a function of the image's name.

    Where levels differ from 0, the covariance is that of a level-0 standard deviation of 1 px.
    Raises InvalidInput without a board or a size, and with file and line for a row that breaks a rule.
    """
    if board is None:
        raise InvalidInput("a .vnl file has no board; give --board", where=str(path))
    if image_size is None:
        raise InvalidInput("a .vnl file has no image size; give it", where=str(path))
    table = _table(str(path), numbered_lines(path))
    names = table.columns["filename"]
    groups = [list(rows) for _, rows in groupby(range(len(table)), key=names.__getitem__)]
    _refuse_scattered(table, groups)
    views = []
    for group in groups:
        name = names[group[0]]
        size = image_size(name) if callable(image_size) else image_size
        views.append(_view(table.rows(np.array(group)), name, size, board))
    return Detections(board, tuple(views))


def _table(path: str, lines: Lines) -> Table:
    """Return the rows as text; the legend is the first line with a single '#'."""
    legend = next((line for _, line in lines if line.startswith("#") and line[1:2] not in ("#", "!")), None)
    names = legend[1:].split() if legend else []
    missing = [name for name in ("filename", "x", "y") if name not in names]
    if missing:
        raise InvalidInput("no legend; the first line of a corners.vnl is '# filename x y level'", where=path)
    rows = [(number, line.split()) for number, line in lines if not line.startswith("#")]
    return Table.of_rows(path, names, [cells for _, cells in rows], [number for number, _ in rows])


def _refuse_scattered(table: Table, groups: Sequence[Sequence[int]]) -> None:
    seen: set[str] = set()
    for group in groups:
        name = table.columns["filename"][group[0]]
        if name in seen:
            where = f"{table.path}:{table.lines[group[0]]}"
            raise InvalidInput(f"rows of image {name!r} are not contiguous", where=where)
        seen.add(name)


def _view(rows: Table, name: str, size: tuple[int, int], board: Board) -> BoardDetection:
    """Return the view of one image's rows."""
    where = f"{rows.path}:{rows.lines[0]}"
    weights = rows.columns.get("level", rows.columns.get("weight", ["0"] * len(rows)))
    seen = np.array([MISSING not in cells for cells in zip(rows.columns["x"], rows.columns["y"], weights, strict=True)])
    if len(rows) == 1 and not seen[0]:
        return BoardDetection(name, size, reason="listed without corners")
    if len(rows) != board.count:
        found = f"image {name!r} has {len(rows)} rows"
        raise InvalidInput(f"{found}; the board has {board.count} points ({board.words})", where=where)
    ids = np.flatnonzero(seen)
    rows = rows.rows(ids)
    pixels = np.column_stack([rows.numbers("x"), rows.numbers("y")])
    std = _relative_std(rows)
    placed = (pixels >= 0).all(axis=1)
    rows.refuse(
        placed & far_outside(pixels, np.array(size)),
        lambda row: f"({pixels[row, 0]:g}, {pixels[row, 1]:g}) is far outside of the image of {size[0]}x{size[1]}",
    )
    kept = placed & np.isfinite(std)
    if not kept.any():
        return BoardDetection(name, size, reason="listed without corners")
    covariance = None if np.all(std[kept] == 1) else std[kept, None, None] ** 2 * np.eye(2)
    return BoardDetection(name, size, ids[kept], pixels[kept], covariance)


def _relative_std(rows: Table) -> Array:
    """Return the standard deviation (N,) of every corner in that of level 0, infinite where it was not seen."""
    if "level" in rows.columns:
        level = np.trunc(rows.numbers("level"))  # mrcal takes the whole part
        return np.where(level < 0, np.inf, 2.0 ** np.clip(level, 0, MAX_LEVEL))
    if "weight" in rows.columns:
        weight = rows.numbers("weight")
        return np.where(weight <= 0, np.inf, 1 / np.where(weight <= 0, 1, weight))
    return np.ones(len(rows))


def text(detections: Detections) -> str:
    """Return the text of a corners.vnl; levels are the covariances' sizes relative to the best corner of the set.

    Raises InvalidInput without a board, and for an image whose name holds white space.
    """
    board = detections.board
    if board is None:
        raise InvalidInput("a .vnl file lists all corners of a board; give --board")
    best = min((std.min() for view in detections.views if (std := _std(view)) is not None), default=1.0)
    lines = ["# filename x y level"]
    for view in detections.views:
        if not view.image or len(view.image.split()) != 1 or view.image.startswith("#"):
            raise InvalidInput(f"image {view.image!r}: a .vnl file cannot hold this name; rename it or write a .csv")
        lines += _rows(view, board, best) if view.found else [f"{view.image} - - -"]
    return "\n".join(lines) + "\n"


def _std(view: BoardDetection) -> Array | None:
    """Return the standard deviation (N,) of one coordinate, px; None if it is not known."""
    if view.covariance is None or not view.found:
        return None
    return np.asarray(np.sqrt(np.trace(view.covariance, axis1=1, axis2=2) / 2))


def _rows(view: BoardDetection, board: Board, best: float) -> Iterator[str]:
    std = _std(view)
    levels = np.zeros(len(view.ids)) if std is None else np.rint(np.log2(std / best))
    cells = [f"{MISSING} {MISSING} {MISSING}"] * board.count
    for i, (u, v), level in zip(view.ids, view.pixels.tolist(), levels, strict=True):
        cells[i] = f"{u!r} {v!r} {int(level)}"
    return (f"{view.image} {cell}" for cell in cells)
