"""Point clouds as files: what a suffix stands for, written from a stream and read back.

Every format's module has write(file, stream), which never asks for the cloud as a whole where the format allows it, and
read(content).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

from camcal.errors import InvalidInput, Located
from camcal.files import read_bytes, replacing
from camcal.formats.pointclouds import glb, las, npz, pcd, ply, xyz
from camcal.formats.pointclouds.record import PointCloudFile
from camcal.stereo.points.frames import VertexStream


@dataclass(frozen=True)
class _Format:
    write: Callable[[BinaryIO, VertexStream], None]
    read: Callable[[bytes], PointCloudFile]
    write_text: Callable[[BinaryIO, VertexStream], None] | None = None


_FORMATS = {
    ".ply": _Format(ply.write, ply.read, ply.write_text),
    ".pcd": _Format(pcd.write, pcd.read, pcd.write_text),
    ".xyz": _Format(xyz.write, xyz.read, xyz.write),
    ".npz": _Format(npz.write, npz.read),
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
