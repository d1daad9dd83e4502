"""Point clouds as files: what a suffix stands for, written from a stream and read back.

Every format has write(file, stream), which never asks for the cloud as a whole where the format allows it, and
read(content); those of plain text (.xyz) and of NumPy (.npz) stand here.
"""

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace
from camcal.errors import CamcalError, FileError, InvalidInput, Located
from camcal.files import read_bytes, replacing
from camcal.formats.documents import parse_json
from camcal.formats.pointclouds import glb, las, pcd, ply
from camcal.formats.pointclouds.record import PointCloudFile, blocks_of, cloud_of, from_comments, numbers_in, text_rows
from camcal.images.image import arrays_of
from camcal.stereo.depth import COLOUR, INTENSITY, METRES, NORMAL, POSITION, SIGMA, VertexStream

_FIELDS: dict[str, tuple[str, ...]] = {
    "points": POSITION,
    "colours": COLOUR,
    "intensity": (INTENSITY,),
    "normals": NORMAL,
    "sigma": (SIGMA,),
}

_PLAIN: dict[int, tuple[str, ...]] = {
    3: POSITION,
    4: (*POSITION, INTENSITY),
    6: (*POSITION, *COLOUR),
    7: (*POSITION, *COLOUR, INTENSITY),
}
_WITH_NORMALS = (*POSITION, *NORMAL)
_COMMENT_MARKS = ("#", "//")


def write_npz(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud, whose arrays are filled block by block."""
    arrays = {
        name: np.empty((stream.count, len(fields)), stream.type[fields[0]])
        for name, fields in _FIELDS.items()
        if fields[0] in (stream.type.names or ())
    }
    at = 0
    for block in blocks_of(stream):
        for name, array in arrays.items():
            for column, field in enumerate(_FIELDS[name]):
                array[at : at + len(block), column] = block[field]
        at += len(block)
    rows = (stream.count,) if stream.grid is None else stream.grid[::-1]
    shaped: dict[str, Any] = {
        name: array.reshape(*rows, *array.shape[1:][array.shape[1] == 1 :]) for name, array in arrays.items()
    }
    words = {"unit": stream.unit, "frame": stream.frame, "notes": json.dumps(stream.notes, ensure_ascii=False)}
    np.savez(file, **(shaped | words))


def read_npz(content: bytes) -> PointCloudFile:
    """Return the vertices of arrays named as above; only points need be there.

    Raises FileError if the file is no NPZ, or an array has another shape than the points have.
    """
    arrays = _arrays(content)
    if "points" not in arrays:
        raise FileError(f"has no array points; its arrays are {', '.join(arrays) or 'none'}")
    shape = arrays["points"].shape[:-1]
    if len(shape) not in {1, 2}:
        raise FileError(f"points have the shape {arrays['points'].shape}, expected (N, 3) or (rows, columns, 3)")
    columns: dict[str, Array] = {}
    for name in _FIELDS.keys() & arrays.keys():
        columns |= _npz_columns(name, arrays[name], shape)
    words = {"unit": str(arrays.get("unit", METRES)), "frame": str(arrays.get("frame", ""))}
    cloud = cloud_of(columns, **words, notes=_notes(arrays))
    return replace(cloud, grid=(shape[1], shape[0])) if len(shape) == 2 else cloud


def _arrays(content: bytes) -> Mapping[str, Any]:
    try:
        return arrays_of(content)
    except ValueError as error:
        raise FileError("not a readable NPZ file (np.savez writes one)") from error


def _npz_columns(name: str, array: Array, shape: tuple[int, ...]) -> dict[str, Array]:
    fields = _FIELDS[name]
    expected = shape if len(fields) == 1 else (*shape, len(fields))
    if array.shape != expected or array.dtype.kind not in "uif":
        raise FileError(f"{name} has {array.dtype} of shape {array.shape}, expected numbers of shape {expected}")
    flat = array.reshape(-1, len(fields))
    return {field: flat[:, column] for column, field in enumerate(fields)}


def _notes(arrays: Mapping[str, Any]) -> dict[str, str]:
    try:
        found = parse_json(str(arrays.get("notes", "{}")))
    except CamcalError:
        return {}
    return {str(key): str(value) for key, value in found.items()} if isinstance(found, dict) else {}


def write_xyz(file: BinaryIO, stream: VertexStream) -> None:
    """Write a cloud, block by block."""
    names = stream.type.names or ()
    if names not in _PLAIN.values() or not stream.count:
        file.write(f"# columns: {' '.join(names)}\n".encode())
    if stream.unit != METRES:
        file.write(f"# unit: {stream.unit}\n".encode())
    file.writelines(text_rows(blocks_of(stream)))


def read_xyz(content: bytes) -> PointCloudFile:
    """Return the vertices of rows of text with blanks, commas or semicolons between the numbers.

    Without a line "# columns: …" 3 numbers are x y z, 4 have the intensity, 6 the colour (normals, unless these three
    are whole numbers from 0 to 255), 7 colour and intensity; with another count all but x y z is left out.
    Raises FileError if the rows are no table of numbers.
    """
    lines = [line.strip() for line in content.decode("utf-8", "replace").splitlines()]
    remarks = [line.lstrip("#/ ") for line in lines if line.startswith(_COMMENT_MARKS)]
    rows = [line.replace(",", " ").replace(";", " ") for line in lines if not line.startswith(_COMMENT_MARKS)]
    numbers = numbers_in([row for row in rows if row.strip()])
    names = next((remark.split()[1:] for remark in remarks if remark.startswith("columns:")), None)
    columns = _xyz_columns(numbers, names) if len(numbers) else dict.fromkeys(names or POSITION, np.empty(0))
    remarks = [remark for remark in remarks if not remark.startswith("columns:")]
    return from_comments(columns, remarks)


def _xyz_columns(numbers: Array, names: list[str] | None) -> dict[str, Array]:
    count = numbers.shape[1]
    if names is not None and len(names) != count:
        raise FileError(f"the file names {len(names)} columns, its rows have {count}")
    if count < len(POSITION):
        raise FileError(f"a row has {count} numbers (minimum 3)")
    return dict(zip(names or _guess(numbers), numbers.T, strict=False))


def _guess(numbers: Array) -> tuple[str, ...]:
    names = _PLAIN.get(numbers.shape[1], POSITION)
    if set(COLOUR) <= set(names):
        colours = numbers[:, 3:6]
        if not np.all((colours >= 0) & (colours <= 255) & (colours == np.rint(colours))):
            return _WITH_NORMALS
    return names


@dataclass(frozen=True)
class _Format:
    write: Callable[[BinaryIO, VertexStream], None]
    read: Callable[[bytes], PointCloudFile]
    write_text: Callable[[BinaryIO, VertexStream], None] | None = None


_FORMATS = {
    ".ply": _Format(ply.write, ply.read, ply.write_text),
    ".pcd": _Format(pcd.write, pcd.read, pcd.write_text),
    ".xyz": _Format(write_xyz, read_xyz, write_xyz),
    ".npz": _Format(write_npz, read_npz),
    ".glb": _Format(glb.write, glb.read),
    ".las": _Format(partial(las.write, compress=False), las.read),
    ".laz": _Format(partial(las.write, compress=True), las.read),
}
SUFFIXES = tuple(_FORMATS)
LASER_SUFFIXES = (".las", ".laz")


def write(path: str | Path, stream: VertexStream, *, ascii_text: bool = False) -> None:
    """Write a cloud as its suffix says, in one step; ascii_text: as text, where the format can be either.

    Raises InvalidInput as `require_suffix` does, FileError if the file cannot be written.
    """
    path = Path(path)
    require_suffix(path, ascii_text=ascii_text)
    form = _FORMATS[path.suffix.lower()]
    with replacing(path) as temporary, temporary.open("wb") as file:
        (form.write_text if ascii_text and form.write_text else form.write)(file, stream)


def read(path: str | Path) -> PointCloudFile:
    """Return what a file holds of a point cloud, by its suffix.

    Raises InvalidInput for another suffix, FileError if the file is missing, empty, truncated or not of that format.
    """
    path = Path(path)
    require_suffix(path)
    content = read_bytes(path)
    with Located(path):
        return _FORMATS[path.suffix.lower()].read(content)


def require_suffix(path: Path, *, ascii_text: bool = False) -> None:
    """Raise InvalidInput unless the name is that of a point cloud that can be written and read, as text if so asked."""
    form = _FORMATS.get(path.suffix.lower())
    if form is None:
        raise InvalidInput(
            f"{path.suffix or 'no suffix'} is not a point cloud format; use one of {' '.join(SUFFIXES)}",
            where=str(path),
        )
    if ascii_text and form.write_text is None:
        texts = " ".join(suffix for suffix, known in _FORMATS.items() if known.write_text)
        raise InvalidInput(f"{path.suffix} has no text form; use {texts}", where=str(path))
    if path.suffix.lower() in LASER_SUFFIXES:
        las.require_laspy()
