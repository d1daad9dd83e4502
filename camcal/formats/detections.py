"""Detections files: mrcal's corners.vnl, corner lists of other programs (see `corner_lists`), or a CSV that anyone can
write by hand or from another tool.

    # camcal-detections 1 board=charuco:9x7:30mm:22mm:DICT_5X5_100
    # image_circle 640,480,319.5,239.5,228.25
    image,width,height,id,u,v
    a.png,640,480,0,101.25,88.5
    # none b.png,640,480,no board found

The first line may be left out. The columns may stand in any order; camera, orientation (the EXIF tag) and suu, suv,
svv (covariance, px²) may be added. id = row · columns + column of the inner corner; pixel (0, 0) is the centre of the
top-left pixel. A '# none' line keeps an image that yielded nothing in its place: image, width, height, reason, then
camera and orientation where they are known.
Of several boards the first line names each, board:a=chessboard:9x6:25mm board:b=…; the column board says which one a
row is of, and ids are those of that board. A '# image_circle' line says which disc of the image the lens lights: width
and height of the image, u and v of the centre, radius, pixels, then camera where it is known. Numbers are written so
that they are read back bit for bit.
"""

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import InvalidInput, Located
from camcal.formats import corner_lists, emit
from camcal.formats.detections_text import CIRCLE, COLUMNS, MAGIC, NONE, OPTIONAL, VERSION, csv_text
from camcal.formats.tables import (
    COVARIANCE,
    Lines,
    Table,
    csv_rows,
    far_outside,
    iterate_lines,
    pixel_covariances,
)
from camcal.parsing import parse_integer
from camcal.targets.board import Board, parse_board
from camcal.targets.board_set import BoardSet, board_set
from camcal.targets.detection import BoardDetection, Detections

MAX_COUNT = 1_000_000
MAX_SIDE = 1_000_000
_BLOCK = 2000  # rows that are held as text at a time; as cells, one takes a kilobyte

Placed = tuple[int, BoardDetection]  # with the line on which the file first names the image
Keys = dict[tuple[str, str, str], int]  # the number of each view by its camera, image and board


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a file: lines (N,), numbers of their views (N,), ids (N,), pixels (N, 2), sizes (N, 2), orientations
    (N, 1), covariances (N, 2, 2) or None.
    """

    lines: Array
    views: Array
    ids: Array
    pixels: Array
    sizes: Array
    orientations: Array
    covariance: Array | None

    @classmethod
    def joined(cls, parts: Sequence["_Rows"]) -> "_Rows":
        """Return the rows of all parts, at least one."""
        columns = zip(*(vars(part).values() for part in parts), strict=True)
        whole: list[Any] = [None if column[0] is None else np.concatenate(column) for column in columns]
        return cls(*whole)


def read(path: str | Path, board: Board | None = None, image_size: corner_lists.ImageSize | None = None) -> Detections:
    """Return the detections in a file, views in the order in which it first names them.

    board: what was searched for; it takes the place of the board a CSV names, and a .vnl names none. image_size: of the
    images of a .vnl, one (width, height) or a function of the image's name; a CSV has its own.
    Raises InvalidInput with file and line for the first row that breaks a rule, FileError if the file cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() == corner_lists.VNL:
        return corner_lists.read_vnl(path, board, image_size)
    if path.suffix.lower() in corner_lists.SUFFIXES:
        return corner_lists.read(path, board, image_size)
    return read_csv(path, board)


def write(path: str | Path, detections: Detections) -> None:
    """Write detections in the form the file's suffix says; raises InvalidInput for what the form cannot hold."""
    path = Path(path)
    form = corner_lists.vnl_text if path.suffix.lower() == corner_lists.VNL else csv_text
    files.write_text(path, form(detections))


def read_csv(path: Path, board: Board | None = None) -> Detections:
    """Return the detections in a CSV file; `board` takes the place of the board the file names."""
    return _of_lines(str(path), iterate_lines(files.read_text(path), str(path)), board)


def parse_csv(text: str, where: str, board: Board | None = None) -> Detections:
    """Return the detections in the text of a CSV file, as `read_csv` does; where: what messages call it."""
    return _of_lines(where, iterate_lines(text, where), board)


def _of_lines(where: str, lines: Iterator[tuple[int, str]], board: Board | None) -> Detections:
    first = list(islice(lines, 1))
    board = _board(where, first[0][1] if first else "", board)
    remarks: list[tuple[int, str]] = []
    views = _views(where, _tables(where, chain(first, lines), remarks), board)
    views += [(number, _nothing(where, number, line)) for number, line in remarks if line.startswith(NONE)]
    views.sort(key=lambda view: view[0])
    _refuse_repeats(where, views)
    _refuse_long(where, views)
    return Detections(board, tuple(view for _, view in views), _circles(where, remarks))


def _tables(where: str, lines: Iterator[tuple[int, str]], remarks: list[tuple[int, str]]) -> Iterator[Table]:
    """Yield the rows of a file in blocks, at least one; lines that begin with # are added to `remarks`."""

    def split() -> Iterator[tuple[int, str]]:
        for line in lines:
            if line[1].startswith("#"):
                remarks.append(line)
            else:
                yield line

    rows = split()
    header, block = list(islice(rows, 1)), list(islice(rows, _BLOCK))
    yield Table.from_csv(where, header + block, COLUMNS, OPTIONAL)
    while block := list(islice(rows, _BLOCK)):
        yield Table.from_csv(where, header + block, COLUMNS, OPTIONAL)


def _board(path: str, first: str, given: Board | None) -> Board | None:
    """Return the given board, or else the one the file's first line names."""
    if not first.startswith(MAGIC):
        return given
    version, *rest = first.removeprefix(MAGIC).split() or [""]
    if version != VERSION:
        raise InvalidInput(f"detections of version {version!r}; this camcal reads {VERSION}", where=f"{path}:1")
    words = dict(word.partition("=")[::2] for word in rest)
    named = _named_board(path, words, "") if "board" in words else None
    several = [word.removeprefix("board:") for word in words if word.startswith("board:")]
    if several:
        with Located(f"{path}:1"):
            named = board_set({name: _named_board(path, words, f":{name}") for name in several})
    if given and named and _numbering(given) != _numbering(named):
        message = f"the points are those of another board ({named.words}) than given ({given.words})"
        raise InvalidInput(message, where=f"{path}:1")
    return given or named


def _numbering(board: Board) -> list[tuple[str, str, int, int]]:
    """Return what determines the numbering: a chessboard, a ChArUco board and a grid of circles do it alike."""
    return [(name, "grid" if own.has_grid else own.type, own.columns, own.rows) for name, own in board.members.items()]


def _named_board(path: str, words: dict[str, str], name: str) -> Board:
    with Located(f"{path}:1"):
        board = parse_board(words[f"board{name}"])
        try:
            return replace(board, first_marker=parse_integer(words.get(f"first_marker_id{name}", "0")))
        except ValueError as error:
            raise InvalidInput("first_marker_id is not a whole number") from error


def _nothing(path: str, number: int, line: str) -> BoardDetection:
    """Return the view of a '# none' line."""
    cells = csv_rows(path, [(number, line.removeprefix(NONE))])[0]
    if not 4 <= len(cells) <= 6:
        raise InvalidInput(f"{NONE}needs IMAGE,WIDTH,HEIGHT,REASON[,CAMERA[,ORIENTATION]]", where=f"{path}:{number}")
    cells += ["", "1"][len(cells) - 4 :]
    names = ("image", "width", "height", "reason", "camera", "orientation")
    table = Table(path, {name: [text] for name, text in zip(names, cells, strict=True)}, [number])
    size, orientation = _sizes(table)[0], int(table.integers("orientation", 1, 8)[0])
    view = BoardDetection(cells[0], (int(size[0]), int(size[1])), reason=cells[3] or "nothing found")
    return replace(view, camera=cells[4], orientation=orientation)


def _circles(path: str, lines: Lines) -> dict[str, ImageCircle]:
    """Return the image circles by the names of their cameras."""
    circles: dict[str, ImageCircle] = {}
    for number, line in lines:
        if line.startswith(CIRCLE):
            camera, circle = _circle(path, number, line)
            if circles.setdefault(camera, circle) is not circle:
                raise InvalidInput(
                    f"a second image circle{f' of {camera}' if camera else ''}", where=f"{path}:{number}"
                )
    return circles


def _circle(path: str, number: int, line: str) -> tuple[str, ImageCircle]:
    """Return the camera and the image circle of a '# image_circle' line."""
    cells = csv_rows(path, [(number, line.removeprefix(CIRCLE))])[0]
    if not 5 <= len(cells) <= 6:
        raise InvalidInput(f"{CIRCLE}needs WIDTH,HEIGHT,U,V,RADIUS[,CAMERA]", where=f"{path}:{number}")
    names = ("width", "height", "u", "v", "radius")
    table = Table(path, {name: [text] for name, text in zip(names, cells[:5], strict=True)}, [number])
    width, height = _sizes(table)[0].tolist()
    u, v, radius = (float(table.numbers(name)[0]) for name in names[2:])
    if radius <= 0:
        raise InvalidInput(f"radius {radius:g} px is not positive", where=f"{path}:{number}")
    return "".join(cells[5:]), ImageCircle((width, height), (u, v), radius)


def _views(path: str, tables: Iterator[Table], board: Board | None) -> list[Placed]:
    """Return the views with points, each with its first line."""
    keys: Keys = {}
    rows = _Rows.joined([_rows_of(table, board, keys) for table in tables])
    if not keys:
        return []
    names, groups = list(keys), np.split(np.argsort(rows.views, kind="stable"), np.cumsum(np.bincount(rows.views))[:-1])
    first = np.array([group[0] for group in groups])
    _refuse_repeated_ids(path, rows, names)
    _refuse_changes(path, "size", rows, rows.sizes, first, names)
    _refuse_changes(path, "orientation", rows, rows.orientations, first, names)
    return [
        (
            int(rows.lines[group[0]]),
            BoardDetection(
                image,
                (int(rows.sizes[group[0], 0]), int(rows.sizes[group[0], 1])),
                rows.ids[group],
                rows.pixels[group],
                _covariance_of_view(path, rows, group),
                camera,
                orientation=int(rows.orientations[group[0], 0]),
                body=body,
            ),
        )
        for (camera, image, body), group in zip(names, groups, strict=True)
    ]


def _rows_of(table: Table, board: Board | None, keys: Keys) -> _Rows:
    """Return the rows of a table; the views that it names first are added to `keys`."""
    images, nameless = table.columns["image"], [""] * len(table)
    cameras, bodies = (table.columns.get(name, nameless) for name in ("camera", "board"))
    triples = zip(cameras, images, bodies, strict=True)
    rows = _Rows(
        np.array(table.lines, dtype=np.int64),
        np.array([keys.setdefault(key, len(keys)) for key in triples], dtype=np.int64),
        _ids(table, board, bodies),
        np.column_stack([table.numbers("u"), table.numbers("v")]),
        _sizes(table),
        _orientations(table),
        _covariance(table),
    )
    _refuse_outside(table, rows.pixels, rows.sizes)
    return rows


def _ids(table: Table, board: Board | None, bodies: Sequence[str]) -> Array:
    """Return the ids (N,) of rows, of several boards those among the points of all."""
    if not isinstance(board, BoardSet):
        return table.integers("id", 0, (board.count if board else MAX_COUNT) - 1)
    places = {name: place for place, name in enumerate(board.names)}
    place = np.array([places.get(name, -1) for name in bodies], np.intp)
    table.refuse(place < 0, lambda row: f"board {bodies[row]!r} is none of {', '.join(board.names)}")
    ids = table.integers("id", 0, MAX_COUNT - 1)
    counts = np.array([own.count for own in board.boards])[place]
    table.refuse(ids >= counts, lambda row: f"id {ids[row]}: board {bodies[row]} has the ids 0 to {counts[row] - 1}")
    return np.asarray(ids + np.array(board.starts)[place])


def _refuse_repeated_ids(path: str, rows: _Rows, names: Sequence[tuple[str, str, str]]) -> None:
    order = np.lexsort((rows.ids, rows.views))
    repeated = np.zeros(len(order), dtype=bool)
    repeated[order[1:]] = (np.diff(rows.ids[order]) == 0) & (np.diff(rows.views[order]) == 0)
    Table(path, {}, rows.lines.tolist()).refuse(
        repeated, lambda row: f"image {names[rows.views[row]][1]!r}: id {rows.ids[row]} occurs twice"
    )


def _sizes(table: Table) -> Array:
    return np.column_stack([table.integers(name, 1, MAX_SIDE) for name in ("width", "height")])


def _orientations(table: Table) -> Array:
    if "orientation" not in table.columns:
        return np.ones((len(table), 1), dtype=np.int64)
    return table.integers("orientation", 1, 8)[:, None]


def _refuse_changes(
    path: str, what: str, rows: _Rows, values: Array, first: Array, names: Sequence[tuple[str, str, str]]
) -> None:
    """Raise InvalidInput unless all rows of a view have the values (N, K) of its first row."""
    before = first[rows.views]
    Table(path, {}, rows.lines.tolist()).refuse(
        np.asarray((values != values[before]).any(axis=1)),
        lambda row: (
            f"image {names[rows.views[row]][1]!r}: {what} {' x '.join(map(str, values[row]))} "
            f"here, {' x '.join(map(str, values[before[row]]))} at line {rows.lines[before[row]]}"
        ),
    )


def _refuse_outside(table: Table, pixels: Array, sizes: Array) -> None:
    table.refuse(
        far_outside(pixels, sizes),
        lambda row: (
            f"image {table.columns['image'][row]!r}: ({pixels[row, 0]:g}, {pixels[row, 1]:g}) "
            f"is far outside the image of {sizes[row, 0]} x {sizes[row, 1]}; check the order of u and v"
        ),
    )


def _covariance(table: Table) -> Array | None:
    """Return the covariances (N, 2, 2) in px², NaN in rows that leave them empty; None without the columns."""
    given = [name for name in COVARIANCE if name in table.columns]
    if not given:
        return None
    if len(given) < len(COVARIANCE):
        raise InvalidInput(f"column {given[0]!r} without the others of {','.join(COVARIANCE)}", where=table.path)
    empty = np.array([[not text.strip() for text in table.columns[name]] for name in COVARIANCE])
    table.refuse(
        np.asarray(empty.any(axis=0) & ~empty.all(axis=0)), lambda _row: f"only a part of {','.join(COVARIANCE)}"
    )
    filled = np.flatnonzero(~empty[0])
    result = np.full((len(table), 2, 2), np.nan)
    result[filled] = pixel_covariances(table.rows(filled))
    return result


def _covariance_of_view(path: str, rows: _Rows, group: Array) -> Array | None:
    if rows.covariance is None:
        return None
    missing = np.isnan(rows.covariance[group, 0, 0])
    if missing.all():
        return None
    Table(path, {}, rows.lines[group].tolist()).refuse(
        missing, lambda _row: "no covariance here, but in other rows of the same image"
    )
    return np.asarray(rows.covariance[group])


def _refuse_repeats(path: str, views: Sequence[Placed]) -> None:
    lines: dict[tuple[str, str, str], int] = {}
    for line, view in views:
        first = lines.setdefault((view.camera, view.image, view.body), line)
        if first != line:
            raise InvalidInput(f"image {view.image!r} is already named at line {first}", where=f"{path}:{line}")


def _refuse_long(path: str, views: Sequence[Placed]) -> None:
    """Raise InvalidInput for a text that a camera file could not hold: before the work, not after it."""
    for line, view in views:
        for text in (view.image, view.reason or ""):
            if (length := len(files.utf8(text))) > emit.MAX_TEXT:
                message = f"{text[:40]}… has {length} bytes; a camera file holds texts of at most {emit.MAX_TEXT}"
                raise InvalidInput(message, where=f"{path}:{line}")
