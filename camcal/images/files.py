"""Image files: pixels as stored; the EXIF orientation is kept but never applied, and written once.

The size that the header of an image file states is found without decoding: memory is taken only for what is allowed.
The type of a file that is written follows from its suffix; it takes the place of another in one step.
Sources: W3C PNG, section 5 and 11.2; ITU-T T.81, annex B; TIFF 6.0, section 2; Microsoft BITMAPINFOHEADER; Netpbm's pnm
and pam; Google's WebP container and lossless bitstream; ITU-T T.800, annex A and I.
"""

import re
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np

from camcal import files
from camcal.arrays import Array
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput, translated
from camcal.files import read_bytes
from camcal.images import exif
from camcal.images.exif import JPEG, LONGEST_EXIF, PNG, insert_exif, read_jpeg, read_png_exif
from camcal.images.image import (
    CHANNELS,
    DTYPES,
    RAW_SUFFIXES,
    Image,
    Scratch,
    conversion_advice,
    foreign_suffix,
    read_npy,
    write_npy,
)
from camcal.images.options import JPEG_QUALITY, require_pixels
from camcal.urls import local

_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
_STARTS = {
    JPEG: "JPEG",
    PNG: "PNG",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"BM": "BMP",
    b"RIFF": "WebP",
    b"\0\0\0\x0cjP": "JPEG 2000",
    b"P5": "PGM",
    b"P6": "PPM",
    b"Pf": "PFM",
    b"PF": "PFM",
    b"GIF8": "GIF",
}
_TAIL = 0.001  # share of the pixels that may lie beyond either end of the 8-bit scale
_SAMPLES = 1 << 20

_CHUNK = 12  # bytes of a chunk of a PNG file around its data: length, kind, checksum
_PACKED = 1040  # deflate makes at most so many bytes of one
_PNM = re.compile(rb"P[1-6fF](?:\s|#[^\n]*\n)+([0-9]{1,9})(?:\s|#[^\n]*\n)+([0-9]{1,9})\s")
_PAM = re.compile(rb"P7\n(?:.*\n)*?WIDTH ([0-9]{1,9})\n(?:.*\n)*?HEIGHT ([0-9]{1,9})\n")
_PAM_HEADER = 1000  # bytes
_OLD_BMP = 12  # bytes of the header that OS/2 writes
_J2K = b"\xff\x4f\xff\x51"
_LARGEST_LOSSLESS = 0x3FFF

Size = tuple[int, int]


def load(path: Path, scratch: Scratch | None = None, content: bytes | None = None) -> Image:
    """Return the image of a file: 8 or 16 bits or floating point, gray, colour or with alpha; or a NumPy file.

    scratch: memory for the pixels of a JPEG file, theirs until the next image is loaded with it. content: of the file,
    where it has been read already.
    Raises FileError if the file is missing, empty, cut off or no image, InvalidInput if it is a camera raw file.
    """
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        raise InvalidInput("is a camera raw file; make an image of it with 'camcal demosaic' first", where=str(path))
    if suffix == ".npy":
        try:
            return Image(read_npy(path, content=content))
        except InvalidInput as error:
            raise FileError(error.message, where=str(path)) from error
    content = read_bytes(path) if content is None else content
    require_allowed(path, content)
    if content.startswith(JPEG):
        return _load_jpeg(path, content, scratch)
    if content.startswith(PNG):
        return _with_exif(_decode(path, content), read_png_exif(content))
    turned = exif.orientation(content)
    # OpenCV turns TIFF images whatever it is asked.
    upright = exif.with_orientation(content, exif.UPRIGHT) if turned != exif.UPRIGHT else content
    return Image(_decode(path, upright), turned)


def require_allowed(path: Path, content: bytes) -> None:
    """Raise FileError unless an image file states a size that is allowed, before any memory is taken for its pixels."""
    try:
        size = stated_size(content)
    except ValueError as error:
        raise FileError(f"{_describe_damage(content)}: {error}", where=str(path)) from error
    if size is not None:
        require_pixels(size, path)


def gray_8bit(pixels: Array) -> Array:
    """Return an image (H, W[, 3 or 4]) as (H, W) uint8; alpha is left out.

    8 bits stay as they are, what `gray_levels` takes beyond 0 or 255 becomes 0 or 255.
    """
    levels = gray_levels(pixels)
    if levels.dtype == np.uint8:
        return levels
    return np.asarray(np.rint(np.clip(np.nan_to_num(levels, nan=0.0), 0, 255)), np.uint8)


def gray_levels(pixels: Array) -> Array:
    """Return an image (H, W[, 3 or 4]) as gray levels (H, W), neither rounded nor cut off; alpha is left out.

    8 bits stay as they are. 16 bits and floating point, whose range says little about the light in them, are
    scaled linearly, as float32: the darkest and the brightest 0.1 % of the pixels lie below 0 and above 255.
    """
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY if pixels.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)
    if pixels.dtype == np.uint8:
        return np.asarray(pixels)
    sample = pixels.ravel()[:: max(1, pixels.size // _SAMPLES)]
    finite = sample[np.isfinite(sample)]
    if not finite.size:
        return np.zeros(pixels.shape, np.float32)
    low, high = np.quantile(finite.astype(float), [_TAIL, 1 - _TAIL])
    with np.errstate(over="ignore", invalid="ignore"):  # infinite pixels, and those far beyond the others
        return np.asarray((pixels.astype(np.float32) - np.float32(low)) * np.float32(255 / max(high - low, 1e-30)))


def _load_jpeg(path: Path, content: bytes, scratch: Scratch | None) -> Image:
    header = read_jpeg(content)
    if not header.complete:
        raise FileError("truncated JPEG data", where=str(path))
    if scratch is None:
        return _with_exif(_decode(path, content), header.exif)
    height_and_width = header.size[::-1]
    shape = height_and_width if header.channels == 1 else (*height_and_width, 3)
    try:
        pixels = cv2.imread(str(local(path)), scratch.array("decoded", shape, np.uint8), _FLAGS)
    except cv2.error as error:
        raise translated(error) or _unreadable(path, content) from error
    if pixels is None:
        raise _unreadable(path, content)
    return _with_exif(pixels, header.exif)


def _with_exif(pixels: Array, block: bytes) -> Image:
    return Image(pixels, exif.orientation(block), block if exif.is_readable(block) else b"")


def _decode(path: Path, content: bytes) -> Array:
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), _FLAGS)
    except cv2.error as error:  # such as more pixels than OpenCV allows
        raise translated(error) or _unreadable(path, content) from error
    if pixels is None:
        raise _unreadable(path, content)
    if pixels.dtype == np.float64:
        with np.errstate(over="ignore"):
            pixels = pixels.astype(np.float32)
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    if pixels.dtype not in DTYPES or channels not in CHANNELS:
        raise FileError(f"{channels} channels of {pixels.dtype} are not supported", where=str(path))
    return np.asarray(pixels)


def _unreadable(path: Path, content: bytes) -> FileError:
    advice = conversion_advice([foreign_suffix(content)])
    return FileError(advice or _describe_damage(content), where=str(path))


def _describe_damage(content: bytes) -> str:
    kind = next((name for start, name in _STARTS.items() if content.startswith(start)), None)
    if kind is None:
        return f"unknown image format (begins with {content[:8]!r})"
    return f"a damaged or truncated {kind} file"


def stated_size(content: bytes) -> Size | None:
    """Return the size (width, height) that the header of an image file states; None for other kinds of files.

    Raises ValueError if the header is damaged, or states what its file is too short for.
    """
    try:
        for starts, read in _READERS:
            if content.startswith(starts):
                return read(content)
    except (struct.error, IndexError) as error:
        raise ValueError("truncated header") from error
    return None


def _png(content: bytes) -> Size:
    """Return the size of a PNG file all of whose chunks lie within it: OpenCV makes room for what a chunk says."""
    width, height, depth, colour = struct.unpack_from(">IIBB", content, 16)
    position = len(PNG)
    while position < len(content):
        length, kind = struct.unpack_from(">I4s", content, position)
        if position + length + _CHUNK > len(content):
            raise ValueError(f"a chunk of {length} bytes exceeds the file")
        position += length + _CHUNK
        if kind == b"IEND":
            break
    bits = width * height * depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1)
    if bits > 8 * _PACKED * len(content):
        raise ValueError(f"{width} x {height} pixels exceed its {len(content)} bytes")
    return width, height


def png_has_colour(content: bytes) -> bool:
    """Return whether the header of a PNG file says that it is in colour: by channels or a palette."""
    return content[25:26] in (b"\2", b"\3", b"\6")


def _jpeg(content: bytes) -> Size:
    size = read_jpeg(content).size
    if size == (0, 0):
        raise ValueError("no frame header")
    return size


def _bmp(content: bytes) -> Size:
    (length,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if length == _OLD_BMP else "<ii", content, 18)
    return width, abs(height)  # below 0: rows from the top down


def _pnm(content: bytes) -> Size:
    match = _PNM.match(content)
    if match is None:
        raise ValueError("width and height are missing")
    return int(match[1]), int(match[2])


def _pam(content: bytes) -> Size:
    match = _PAM.match(content[:_PAM_HEADER])
    if match is None:
        raise ValueError("WIDTH and HEIGHT are missing")
    return int(match[1]), int(match[2])


def _webp(content: bytes) -> Size:
    kind = content[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(content[24:27], "little"), 1 + int.from_bytes(content[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return 1 + (bits & _LARGEST_LOSSLESS), 1 + (bits >> 14 & _LARGEST_LOSSLESS)
    width, height = struct.unpack_from("<HH", content, 26)
    return width & _LARGEST_LOSSLESS, height & _LARGEST_LOSSLESS


def _jpeg_2000(content: bytes) -> Size:
    """Return the size of the code stream, which is what a decoder makes room for."""
    start = content.find(_J2K)
    if start < 0:
        raise ValueError("no code stream")
    right, bottom, left, top = struct.unpack_from(">IIII", content, start + 8)
    return right - left, bottom - top


_READERS: tuple[tuple[bytes | tuple[bytes, ...], Callable[[bytes], Size]], ...] = (
    (PNG, _png),
    (JPEG, _jpeg),
    ((b"II*\0", b"MM\0*"), exif.stated_size),
    (b"BM", _bmp),
    (b"P7", _pam),
    ((b"P1", b"P2", b"P3", b"P4", b"P5", b"P6", b"PF", b"Pf"), _pnm),
    (b"RIFF", _webp),
    ((b"\0\0\0\x0cjP", _J2K), _jpeg_2000),
)


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
        files.write_bytes(path, _with_metadata(_encode(path, image.pixels, quality), image))


def require_kind(path: Path, image: Image) -> None:
    """Raise InvalidInput, with the suffixes that will do, unless the type of file can hold the image."""
    kind = KINDS.get(path.suffix.lower())
    wanted = (str(image.pixels.dtype), image.channels)
    if kind is not None and wanted[0] in kind.dtypes and wanted[1] in kind.channels:
        return
    fitting = [suffix for suffix, other in KINDS.items() if wanted[0] in other.dtypes and wanted[1] in other.channels]
    held = f"{path.suffix or 'no suffix'} cannot hold {wanted[1]} channel{'s' * (wanted[1] > 1)} of {wanted[0]}"
    raise InvalidInput(f"{held}; use one of {', '.join(fitting)}", where=str(path))


def _encode(path: Path, pixels: Array, quality: int) -> bytes:
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
