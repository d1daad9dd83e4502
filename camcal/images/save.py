"""Writing images: type by suffix, atomic replacement, orientation kept once."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.images import exif
from camcal.images.exif import JPEG, LONGEST_EXIF, PNG, insert_exif
from camcal.images.image import Image
from camcal.images.npy import write_npy
from camcal.images.options import JPEG_QUALITY


@dataclass(frozen=True)
class Kind:
    """What a type of file holds: types of numbers, numbers of channels, and whether it keeps the EXIF orientation."""

    dtypes: tuple[str, ...]
    channels: tuple[int, ...]
    oriented: bool = False


_JPEG = Kind(("uint8",), (1, 3), oriented=True)
_PNG = Kind(("uint8", "uint16"), (1, 3, 4), oriented=True)
_TIFF = Kind(("uint8", "uint16", "float32"), (1, 3, 4), oriented=True)
_NPY = Kind(("uint8", "uint16", "float32"), (1, 3, 4))
KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        ".jpg": _JPEG,
        ".jpeg": _JPEG,
        ".png": _PNG,
        ".tif": _TIFF,
        ".tiff": _TIFF,
        ".npy": _NPY,
        ".ppm": Kind(("uint8", "uint16"), (3,)),
        ".pgm": Kind(("uint8", "uint16"), (1,)),
        ".bmp": Kind(("uint8",), (1, 3)),
    }
)


def save(path: Path, image: Image | Array, *, quality: int = JPEG_QUALITY) -> None:
    """Write an image, or its pixels alone, in one step; orientation and EXIF block go with it where the type has them.

    quality: of JPEG, 1 … 100. A TIFF file keeps the orientation, not the rest of EXIF.
    Raises InvalidInput if the type of file cannot hold the pixels, FileError if it cannot be written.
    """
    if not isinstance(image, Image):
        image = Image(image)
    if not 1 <= quality <= 100:
        raise InvalidInput(f"JPEG quality is 1 … 100, found {quality}")
    require_kind(path, image)
    if path.suffix.lower() == ".npy":
        write_npy(path, image.pixels)
    else:
        files.write_bytes(path, _with_metadata(_encoded(path, image.pixels, quality), image))


def require_kind(path: Path, image: Image) -> None:
    """Raise InvalidInput, with the suffixes that will do, unless the type of file can hold the image."""
    kind = KINDS.get(path.suffix.lower())
    wanted = (str(image.pixels.dtype), image.channels)
    if kind is not None and wanted[0] in kind.dtypes and wanted[1] in kind.channels:
        return
    fitting = [suffix for suffix, other in KINDS.items() if wanted[0] in other.dtypes and wanted[1] in other.channels]
    held = f"{path.suffix or 'no suffix'} cannot hold {wanted[1]} channel{'s' * (wanted[1] > 1)} of {wanted[0]}"
    raise InvalidInput(f"{held}; use one of {', '.join(fitting)}", where=str(path))


def _encoded(path: Path, pixels: Array, quality: int) -> bytes:
    suffix = path.suffix.lower()
    parameters = {
        _JPEG: [cv2.IMWRITE_JPEG_QUALITY, quality],
        _TIFF: [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_NONE],  # packing takes twenty times as long
    }.get(KINDS[suffix], [])
    try:
        done, content = cv2.imencode(suffix, pixels, parameters)
    except cv2.error as error:
        raise FileError("cannot be encoded; the image may be too large for this file type", where=str(path)) from error
    if not done:
        raise FileError("cannot be encoded", where=str(path))
    return np.asarray(content).tobytes()


def _with_metadata(content: bytes, image: Image) -> bytes:
    """Return an encoded image with its EXIF block, and the orientation in it once."""
    if content[:4] in (b"II*\0", b"MM\0*"):
        return exif.with_orientation(content, image.orientation) if image.orientation != exif.UPRIGHT else content
    if not content.startswith((JPEG, PNG)):
        return content
    if not image.exif and image.orientation == exif.UPRIGHT:
        return content
    block = exif.of_image(image.exif, image.size) if exif.is_readable(image.exif) else b""
    if content.startswith(JPEG) and len(block) > LONGEST_EXIF:
        block = b""
    return insert_exif(content, exif.with_orientation(block, image.orientation))
