"""Corner lists of other programs as detections, each known by its content, and mrcal's corners.vnl.

MATLAB: imagePoints (N, 2, P) with worldPoints (N, 2), or boardSize (rows, columns of squares), whose corners are
counted down the columns; the centre of the top-left pixel is 1, 1. Bouguet's toolbox, calib_data.mat: x_1 (2, N) and
X_1 (3, N), mm, pixels from 0. PhotonVision: the observations of a calibration, m, pixels from 0, negative where there
is no corner. Deltille, a file for each image: rows board, id, ordered, x, y; its ids are those of a chessboard.

Where points of the board are told they number its corners; which way its rows run is as the images show it.
Source: detectCheckerboardPoints; saving_calib.m and click_calib.m; BoardObservation.java; DeltilleDetector.cpp.

corners.vnl: white-space columns filename, x, y and a level, all corners of the board in order. Every image has one row
per corner, along the board's rows, with '-' for what was not seen, or a single row of '-'. The level says at which
power of two of reduction a corner was found: its standard deviation is 2^level times that of level 0, which mrcal takes
from the residuals. A negative level or coordinate means not seen. A file has neither the board nor the size of the
images; both come from the caller. Source: mrcal 2.5, mrcal.compute_chessboard_corners.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput, Located
from camcal.formats.documents import parse_json
from camcal.formats.tables import Lines, Table, far_outside, numbered_lines
from camcal.targets.board import CHESSBOARD, Board
from camcal.targets.detection import BoardDetection, Detections

DELTILLE = ".orpc"
SUFFIXES = (".mat", ".m", ".json", DELTILLE)

_LARGEST = 512 << 20  # bytes; PhotonVision keeps its pictures in the file
_OFF_GRID, _CLOSE = 0.02, 1e-4  # of a square, and of the whole: numbers that differ by less are one

# points (N, 2) of the board, or numbers (N,) of its corners, and pixels (N, 2), NaN for none, by the names of images
_Images = dict[str, tuple[Array, Array]]
# with width and height, and the unit of the points in metres, where they are told
_Told = tuple[_Images, tuple[Any, Any] | None, float | None]

VNL = ".vnl"
MISSING = "-"
MAX_LEVEL = 20

ImageSize = tuple[int, int] | Callable[[str], tuple[int, int]]


def read(path: Path, board: Board | None, image_size: ImageSize | None = None) -> Detections:
    """Return the detections in a corner list; board: in the place of the chessboard that its points make up.

    image_size: of images whose size it does not tell. Raises InvalidInput for another board, or if something is missing
    or no corner list; FileError.
    """
    with Located(path):
        content = files.read_bytes(path, _LARGEST)
        try:
            reader = next((reader for sign, reader in _READERS if re.match(sign, content)), None)
            images, told, metres = reader(content) if reader else ({}, None, None)
            size = told and (int(told[0]), int(told[1]))
            images = {name: each for name, each in images.items() if np.isfinite(each[1]).any()}
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError) as error:
            raise FileError("a damaged or truncated corner list") from error
        if not images:
            known = "imagePoints of MATLAB, x_1 of Bouguet's calib_data.mat, observations of PhotonVision, .orpc files"
            raise InvalidInput(f"holds no corners that camcal knows: {known}")
        if next(iter(images.values()))[0].ndim > 1:
            board, images = _numbered(images, metres, board)
        if board is None:
            raise InvalidInput("names no board: give --board, such as --board chessboard:9x6:25mm")
        if image_size is None and size is None:
            raise InvalidInput("tells no size of its images: set --image-size WxH")
        views = []
        for name, (ids, pixels) in images.items():
            own = size or (image_size(name) if callable(image_size) else image_size) or (0, 0)
            order = np.argsort(ids)[np.isfinite(pixels[np.argsort(ids)]).all(axis=1)]
            view = BoardDetection(name, own, ids[order].astype(np.intp), pixels[order])
            if min(own) < 1 or view.ids.max() >= board.count or far_outside(view.pixels, np.array(view.size)).any():
                raise InvalidInput(f"{name}: corners beyond the board or the image")
            views.append(view)
        return Detections(board, tuple(views))


def _numbered(images: _Images, metres: float | None, board: Board | None) -> tuple[Board, _Images]:
    """Return the board, and the images with the numbers of its corners; raises InvalidInput for another board."""
    every = np.concatenate([points for points, _ in images.values()])
    low, reach = every.min(axis=0), float(np.ptp(every, axis=0).max())
    steps = np.concatenate([np.diff(np.unique(axis)) for axis in every.T])
    step = reach / max(1.0, np.rint(reach / steps[steps > _CLOSE * reach].min(initial=np.inf)))
    exact = (every - low) / (step or np.nan)
    if not np.abs(exact - np.rint(exact)).max() < _OFF_GRID:
        raise InvalidInput("its points are no grid of squares")
    cells = {name: np.rint((points - low) / step) for name, (points, _) in images.items()}
    columns, rows = (1 + int(side) for side in np.rint(exact.max(axis=0)))
    if sum(_turn(cells[name], pixels) for name, (_, pixels) in images.items()) < 0:  # y upwards
        cells = {name: np.array([0, rows - 1]) + [1, -1] * each for name, each in cells.items()}
    if board is not None and board.columns != columns and board.columns == rows:
        cells = {name: np.array([0, columns - 1]) + [1, -1] * each[:, ::-1] for name, each in cells.items()}
        columns, rows = rows, columns
    board = board or Board(CHESSBOARD, columns, rows, None if metres is None else float(f"{step * metres:.6g}"))
    if not board.has_grid or (board.columns, board.rows) != (columns, rows):
        raise InvalidInput(f"its points are those of {columns}x{rows} corners, not of a {board.words}")
    return board, {name: (cells[name] @ [1, columns], pixels) for name, (_, pixels) in images.items()}


def _turn(cells: Array, pixels: Array) -> float:
    """Return 1 if the axes of the board turn as those of the image do, from x to y, -1 if the other way."""
    seen = np.isfinite(pixels).all(axis=1)
    terms = np.column_stack([cells[seen], np.ones(np.count_nonzero(seen))])
    return float(np.sign(np.linalg.det(np.linalg.lstsq(terms, pixels[seen], rcond=None)[0][:2])))


def _mat(content: bytes) -> _Told:
    from camcal.formats.cameras import mat  # here, since it loads what reads camera files

    data = mat.variables(content)
    return _bouguet(data) if "n_ima" in data else _matlab(data)


def _matlab(data: Mapping[str, Any]) -> _Told:
    told = {key: each for inner in data.values() if isinstance(inner, dict) for key, each in inner.items()}
    told |= data
    pixels = np.array(told.get("imagePoints", [[[], []]]), float) - 1
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    world = told.get("worldPoints") or told.get("WorldPoints")
    points = world or [divmod(number, int(told["boardSize"][0]) - 1) for number in range(len(pixels))]
    images = {f"image{1 + n:03d}": (np.array(points, float), pixels[..., n]) for n in range(pixels.shape[2])}
    size = told.get("imageSize") or told.get("ImageSize")
    return images, size and (size[1], size[0]), 1e-3 if world else None


def _bouguet(data: Mapping[str, Any]) -> _Told:
    images = {}
    for number in range(1, 1 + int(data["n_ima"])):
        pixels, points = (np.array(data[f"{letter}_{number}"], float) for letter in "xX")
        if pixels.ndim > 1:
            images[f"{data['calib_name']}{number}"] = points[:2].T, pixels.T
    return images, (data["nx"], data["ny"]), 1e-3


def _photonvision(content: bytes) -> _Told:
    data, images = parse_json(content.decode("utf-8-sig")), {}
    for number, each in enumerate(data["observations"]):
        points, pixels = (
            np.array([(at["x"], at["y"]) for at in each[f"locationIn{space}Space"]], float).reshape(-1, 2)
            for space in ("Object", "Image")
        )
        pixels = np.where((pixels < 0).any(axis=1, keepdims=True), np.nan, pixels) + 0 * points
        images[each.get("snapshotName") or f"image{number:03d}"] = points, pixels
    return images, (data["resolution"]["width"], data["resolution"]["height"]), 1.0


def _deltille(content: bytes) -> _Told:
    head, _, rows = content.decode("utf-8", "replace").partition("encoding: ascii")
    told = dict(line.split(": ", 1) for line in head.splitlines())
    cells = np.array([line.split(",") for line in rows.split()], float).reshape(-1, 5)
    if len(cells) != int(told["num_corners"]) or (cells[:, 1] < 0).any() or cells[:, 0].any():
        raise ValueError("another number of corners, or those of several boards")
    return {told["filename"]: (cells[:, 1], cells[:, 3:])}, (told["width"], told["height"]), None


_READERS: tuple[tuple[bytes, Callable[[bytes], _Told]], ...] = (
    (rb"MATLAB [57]\.\d", _mat),
    (rb"(?:\xef\xbb\xbf)?\s*\{[\s\S]*\"observations\"", _photonvision),
    (rb"filename: [^\n]*\nwidth: ", _deltille),
)


def read_vnl(path: Path, board: Board | None, image_size: ImageSize | None) -> Detections:
    """Return the detections in a corners.vnl; image_size: one (width, height) or a function of the image's name.

    Where levels differ from 0, the covariance is that of a level-0 standard deviation of 1 px.
    Raises InvalidInput without a board or a size, and with file and line for a row that breaks a rule.
    """
    if board is None:
        raise InvalidInput("a .vnl file has no board; give --board", where=str(path))
    if image_size is None:
        raise InvalidInput("a .vnl file has no image size; give it", where=str(path))
    table = _vnl_table(str(path), numbered_lines(path))
    names = table.columns["filename"]
    groups = [list(rows) for _, rows in groupby(range(len(table)), key=names.__getitem__)]
    _refuse_scattered(table, groups)
    views = []
    for group in groups:
        name = names[group[0]]
        size = image_size(name) if callable(image_size) else image_size
        views.append(_vnl_view(table.rows(np.array(group)), name, size, board))
    return Detections(board, tuple(views))


def _vnl_table(path: str, lines: Lines) -> Table:
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


def _vnl_view(rows: Table, name: str, size: tuple[int, int], board: Board) -> BoardDetection:
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


def vnl_text(detections: Detections) -> str:
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
        lines += _vnl_rows(view, board, best) if view.found else [f"{view.image} - - -"]
    return "\n".join(lines) + "\n"


def _std(view: BoardDetection) -> Array | None:
    """Return the standard deviation (N,) of one coordinate, px; None if it is not known."""
    if view.covariance is None or not view.found:
        return None
    return np.asarray(np.sqrt(np.trace(view.covariance, axis1=1, axis2=2) / 2))


def _vnl_rows(view: BoardDetection, board: Board, best: float) -> Iterator[str]:
    std = _std(view)
    levels = np.zeros(len(view.ids)) if std is None else np.rint(np.log2(std / best))
    cells = [f"{MISSING} {MISSING} {MISSING}"] * board.count
    for i, (u, v), level in zip(view.ids, view.pixels.tolist(), levels, strict=True):
        cells[i] = f"{u!r} {v!r} {int(level)}"
    return (f"{view.image} {cell}" for cell in cells)
