"""Reading images: pixels as the file holds them, the EXIF orientation noted and never applied."""

from pathlib import Path

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput, translated
from camcal.files import read_bytes
from camcal.images import containers, exif, headers, limits
from camcal.images.image import CHANNELS, DTYPES, RAW_SUFFIXES, Image
from camcal.images.npy import read_npy
from camcal.images.scratch import Scratch

__all__ = ["Image", "gray_8bit", "load", "load_gray"]

_FLAGS = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
_STARTS = {
    containers.JPEG: "JPEG",
    containers.PNG: "PNG",
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


def load(path: Path, scratch: Scratch | None = None) -> Image:
    """Return the image of a file: 8 or 16 bits or floating point, gray, colour or with alpha; or a NumPy file.

    scratch: memory for the pixels of a JPEG file, theirs until the next image is loaded with it.
    Raises FileError if the file is missing, empty, cut off or no image, InvalidInput if it is a camera raw file.
    """
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        raise InvalidInput("is a camera raw file; make an image of it with 'camcal demosaic' first", where=str(path))
    if suffix == ".npy":
        return _load_npy(path)
    content = read_bytes(path)
    require_allowed(path, content)
    if content.startswith(containers.JPEG):
        return _load_jpeg(path, content, scratch)
    if content.startswith(containers.PNG):
        return _with_exif(_decode(path, content), containers.read_png_exif(content))
    turned = exif.orientation(content)
    # OpenCV turns TIFF images whatever it is asked.
    upright = exif.with_orientation(content, exif.UPRIGHT) if turned != exif.UPRIGHT else content
    return Image(_decode(path, upright), turned)


def require_allowed(path: Path, content: bytes) -> None:
    """Raise FileError unless an image file states a size that is allowed, before any memory is taken for its pixels."""
    try:
        size = headers.stated_size(content)
    except ValueError as error:
        raise FileError(f"{_damaged(content)}: {error}", where=str(path)) from error
    if size is not None:
        limits.require_pixels(size, path)


def load_gray(path: Path) -> Array:
    """Return the image of a file as (H, W) uint8, for detectors; see `load` and `gray_8bit`."""
    return gray_8bit(load(path).pixels)


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
    known = sample[np.isfinite(sample)]
    if not known.size:
        return np.zeros(pixels.shape, np.float32)
    low, high = np.quantile(known.astype(float), [_TAIL, 1 - _TAIL])
    with np.errstate(over="ignore", invalid="ignore"):  # infinite pixels, and those far beyond the others
        return np.asarray((pixels.astype(np.float32) - np.float32(low)) * np.float32(255 / max(high - low, 1e-30)))


def _load_npy(path: Path) -> Image:
    try:
        return Image(read_npy(path))
    except InvalidInput as error:
        raise FileError(error.message, where=str(path)) from error


def _load_jpeg(path: Path, content: bytes, scratch: Scratch | None) -> Image:
    header = containers.read_jpeg(content)
    if not header.complete:
        raise FileError("is cut off: the end of the JPEG data is missing", where=str(path))
    if scratch is None:
        return _with_exif(_decode(path, content), header.exif)
    height_and_width = header.size[::-1]
    shape = height_and_width if header.channels == 1 else (*height_and_width, 3)
    try:
        pixels = cv2.imread(str(path), scratch.array("decoded", shape, np.uint8), _FLAGS)
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
    return FileError(_damaged(content), where=str(path))


def _damaged(content: bytes) -> str:
    kind = next((name for start, name in _STARTS.items() if content.startswith(start)), None)
    if kind is None:
        return f"not an image of a known kind (it begins with {content[:8]!r})"
    return f"a damaged or cut off {kind} file"
