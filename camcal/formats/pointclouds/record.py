"""A point cloud as read from a file, and what all formats share: comments, and columns under their usual names.

Text has nine significant digits, all that a float32 holds.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain, product

import numpy as np
from numpy.typing import NDArray

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass, field
from camcal.errors import FileError
from camcal.stereo.depth import COLOUR, INTENSITY, METRES, NORMAL, POSITION, SIGMA, VertexStream, vertex_type

MILLIMETRES = "mm"

_ALIASES = {
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "red": ("red", "r", "diffuse_red"),
    "green": ("green", "g", "diffuse_green"),
    "blue": ("blue", "b", "diffuse_blue"),
    "nx": ("nx", "normal_x"),
    "ny": ("ny", "normal_y"),
    "nz": ("nz", "normal_z"),
    INTENSITY: (INTENSITY, "scalar_intensity"),
    SIGMA: (SIGMA, "scalar_sigma"),
}
_HOUSE_TYPES = {
    vertex_type(colour=colour, intensity=intensity, normals=normals, sigma=sigma)
    for colour, intensity, normals, sigma in product((False, True), repeat=4)
}
_FAR = 1 << 17  # beyond, float32 is coarser than 8 mm
_UNITS = {"metre": METRES, "meter": METRES, "millimetre": MILLIMETRES, "millimeter": MILLIMETRES}
_ROWS = 1 << 12  # turned into text at a time: Python's numbers take ten times the room of the array's
_NUMBER = {"f": "%.9g", "u": "%d"}


@dataclass(frozen=True, eq=False)
class PointCloudFile:
    """What a file holds of a point cloud.

    vertices: structured array (N,), read-only, of a `stereo.vertices.vertex_type`. unit: of x y z and sigma, m or mm or
    another that the file says, metres where it says none. frame: in words, empty where the file says none. notes:
    further comments of the form "key: value". grid: (width, height) if the vertices are the pixels of an image, row by
    row; None otherwise.
    """

    vertices: NDArray[np.void]
    unit: str = METRES
    frame: str = ""
    notes: Mapping[str, str] = field(default_factory=dict)
    grid: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        view = self.vertices.view()
        view.setflags(write=False)
        object.__setattr__(self, "vertices", view)


def blocks_of(stream: VertexStream) -> Iterator[Array]:
    """Yield the blocks of a stream, contiguous.

    Raises ValueError for a block of another type, and at the end unless they held stream.count vertices.
    """
    written = 0
    for block in stream.blocks:
        if block.dtype != stream.type:
            raise ValueError(f"a block holds {block.dtype}, the stream promised {stream.type}")
        written += len(block)
        yield np.ascontiguousarray(block)
    if written != stream.count:
        raise ValueError(f"the blocks hold {written} vertices, the stream promised {stream.count}")


def comments_of(stream: VertexStream) -> list[str]:
    """Return what files with room for comments say of a stream, as "key: value" on a line each."""
    said = {"unit": stream.unit, "frame": stream.frame, **stream.notes}
    return [files.utf8(" ".join(f"{key}: {value}".splitlines())).decode() for key, value in said.items()]


def from_comments(columns: Mapping[str, Array] | Array, comments: Sequence[str]) -> PointCloudFile:
    """Return a point cloud with what its comments say of unit, frame and more; other comments are left out.

    columns: as `cloud_of` takes them, or all in one structured array (N,).
    """
    pairs = (comment.partition(": ") for comment in comments)
    notes = {key.strip(): value.strip() for key, colon, value in pairs if colon}
    unit = notes.pop("unit", METRES)
    unit, frame = _UNITS.get(unit.rstrip("s"), unit), notes.pop("frame", "")
    if isinstance(columns, Mapping):
        return cloud_of(columns, unit=unit, frame=frame, notes=notes)
    if columns.dtype in _HOUSE_TYPES:
        return PointCloudFile(columns, unit, frame, notes)
    return cloud_of({name: columns[name] for name in columns.dtype.names or ()}, unit=unit, frame=frame, notes=notes)


def cloud_of(
    columns: Mapping[str, Array],
    *,
    unit: str = METRES,
    frame: str = "",
    notes: Mapping[str, str] | None = None,
) -> PointCloudFile:
    """Return a point cloud from columns (N,) under the names that programs give them; other columns are left out.

    Colours are 0 … 255 as uint8, 0 … 65535 as uint16, 0 … 1 or 0 … 255 as floating point; intensity as an unsigned
    integer is a share of the largest one. Coordinates too large for float32, such as those of a map, are taken from a
    whole number that the note "origin" says.
    Raises FileError without x, y and z, and for columns of different lengths.
    """
    known = _known(columns)
    lengths = {name: len(column) for name, column in known.items()}
    if len(set(lengths.values())) > 1:
        raise FileError(f"the columns have different lengths: {lengths}")
    origin = [_origin(known[name]) for name in POSITION]
    notes = dict(notes or {})
    if any(origin):
        known |= {name: known[name] - start for name, start in zip(POSITION, origin, strict=True)}
        notes["origin"] = " ".join(f"{start:.0f}" for start in origin)
    kind = vertex_type(
        colour=known.keys() >= set(COLOUR),
        intensity=INTENSITY in known,
        normals=known.keys() >= set(NORMAL),
        sigma=SIGMA in known,
    )
    vertices = np.empty(len(known["x"]), kind)
    with np.errstate(over="ignore"):
        for name in kind.names or ():
            vertices[name] = _CONVERSIONS.get(name, np.asarray)(known[name])
    return PointCloudFile(vertices, unit, frame, notes)


def _known(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns under their usual names; raises FileError without x, y and z."""
    lower = {name.lower(): column for name, column in columns.items() if column.ndim == 1}
    known = {
        name: next(lower[alias] for alias in aliases if alias in lower)
        for name, aliases in _ALIASES.items()
        if any(alias in lower for alias in aliases)
    }
    if not known.keys() >= set(POSITION):
        raise FileError(f"holds no x, y and z; its columns are {', '.join(columns) or 'none'}")
    return known


def _origin(column: Array) -> float:
    """Return the whole number to be taken from a coordinate (N,), 0 where float32 holds it well enough."""
    if column.dtype != np.float64:
        return 0.0
    finite = column[np.isfinite(column)]
    return float(np.floor(finite.min())) if _loses_digits(finite[np.abs(finite) > _FAR]) else 0.0


def _loses_digits(large: Array) -> bool:
    """Return whether numbers (N,) are more than float32 holds, or than its nine digits as text say of it."""
    with np.errstate(over="ignore"):
        single = large.astype(np.float32).astype(np.float64)
    large, single = large[np.isfinite(single)], single[np.isfinite(single)]
    digit = 10.0 ** (np.floor(np.log10(np.abs(single))) - 8)  # what the ninth one stands for
    as_text = np.rint(single / digit) * digit
    return bool(np.any((single != large) & ~np.isclose(as_text, large, rtol=1e-14, atol=0)))


def _as_byte(column: Array) -> Array:
    """Return a colour (N,) as 0 … 255."""
    if column.dtype == np.uint8:
        return column
    if column.dtype == np.uint16:
        return np.rint(column / 257).astype(np.uint8)
    values = np.nan_to_num(column.astype(np.float64), posinf=0.0, neginf=0.0)
    if column.dtype.kind == "f" and values.max(initial=0.0) <= 1:
        values = values * 255
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)


def _as_share(column: Array) -> Array:
    return column / np.float32(np.iinfo(column.dtype).max) if column.dtype.kind == "u" else column


_CONVERSIONS = {**dict.fromkeys(COLOUR, _as_byte), INTENSITY: _as_share}


def text_rows(blocks: Iterable[Array]) -> Iterator[bytes]:
    """Yield structured arrays (N,) as lines of numbers with blanks between them."""
    for block in blocks:
        row = " ".join(_NUMBER[block.dtype[name].kind] for name in block.dtype.names or ()) + "\n"
        for start in range(0, len(block), _ROWS):
            part = block[start : start + _ROWS].tolist()
            yield (row * len(part) % tuple(chain.from_iterable(part))).encode("ascii")


def text_table(lines: Sequence[str], kind: np.dtype[np.void]) -> Array:
    """Return lines of text as a structured array (N,) of the type `kind`.

    Raises FileError naming what was expected and found.
    """
    names = kind.names or ()
    found = np.empty(len(lines), kind)
    with np.errstate(invalid="ignore", over="ignore"):
        for name, column in zip(names, numbers_in(lines, len(names)).T, strict=True):
            found[name] = column
    return found


def numbers_in(lines: Sequence[str], columns: int | None = None) -> Array:
    """Return the numbers of lines of text, (N, columns) float64; None for as many columns as there are.

    Raises FileError if they are no table, or one of another width.
    """
    if not lines:
        return np.empty((0, columns or 0))
    try:
        found: Array = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
    except ValueError as error:
        cause = str(error).partition(";")[0].rstrip(".")  # without NumPy's advice to programmers
        raise FileError(f"vertex rows are not a table of numbers: {cause}") from error
    if columns not in {None, found.shape[1]}:
        raise FileError(f"a vertex has {columns} numbers by the header, a row has {found.shape[1]}")
    return found
