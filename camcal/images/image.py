"""Images in memory: pixels with what their file said about them, and memory used again; .npy and .npz files."""

import io
import math
import zlib
from collections.abc import Iterable
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.typing import DTypeLike

from camcal.arrays import Array, PixelArray
from camcal.dataclass import dataclass
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes, replacing

DTYPES = (np.uint8, np.uint16, np.float32)
CHANNELS = (1, 3, 4)
# fmt: off
RAW_SUFFIXES = frozenset({
    ".3fr", ".arw", ".cr2", ".cr3", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".k25", ".kdc",
    ".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".rw2", ".rwl", ".sr2", ".srf",
    ".srw", ".x3f",
})
# fmt: on
_FOREIGN = {  # kinds of images that are not read: by their suffixes
    "HEIF": (".heic", ".heif", ".hif"),
    "AVIF": (".avif",),
    "JPEG XL": (".jxl",),
    "Photoshop": (".psd", ".psb"),
    "GIMP": (".xcf",),
    "SVG": (".svg",),
}
_FOREIGN_STARTS = {
    b"ftypheic": ".heic", b"ftypheix": ".heic", b"ftypmif1": ".heic", b"ftypavif": ".avif", b"8BPS": ".psd",
    b"<svg": ".svg", b"gimp xcf": ".xcf",
}  # fmt: skip


def conversion_advice(suffixes: Iterable[str]) -> str:
    """Return what to do about images of kinds that are not read, by their suffixes; empty where there is none such."""
    lower = {suffix.lower() for suffix in suffixes}
    kinds = [kind for kind, known in _FOREIGN.items() if lower & set(known)]
    if not kinds:
        return ""
    suffix = next(suffix for suffix in _FOREIGN[kinds[0]] if suffix in lower)
    heif_advice = f"'heif-convert photo{suffix} photo.png' or " if kinds[0] == "HEIF" else ""
    how = f"{heif_advice}'magick mogrify -format png *{suffix}'"
    return f"{' and '.join(kinds)} images are not read: convert them to PNG or JPEG first, such as with {how}"


def foreign_suffix(content: bytes) -> str:
    """Return the suffix of a kind of images that is not read, by the beginning of a file; empty for others."""
    starts = (content[:8], content[4:12])
    return next(
        (suffix for start, suffix in _FOREIGN_STARTS.items() if any(each.startswith(start) for each in starts)), ""
    )


@dataclass(frozen=True, eq=False)
class Image:
    """An image as the sensor saw it.

    pixels: (H, W) gray, (H, W, 3) blue, green, red, or (H, W, 4) with alpha; uint8, uint16 or float32; read-only,
    not copied. orientation: the EXIF tag 1 … 8, how to turn the image for looking at it, never applied to pixels.
    exif: the EXIF block as it stood in the file, empty without one.
    """

    pixels: PixelArray
    orientation: int = 1
    exif: bytes = b""

    def __post_init__(self) -> None:
        pixels = np.asarray(self.pixels)
        if pixels.ndim == 3 and pixels.shape[2] == 1:
            pixels = pixels[:, :, 0]
        channels = 1 if pixels.ndim == 2 else pixels.shape[-1]
        if pixels.ndim not in (2, 3) or channels not in CHANNELS or pixels.size == 0:
            raise InvalidInput(f"an image is (H, W), (H, W, 3) or (H, W, 4), found the shape {pixels.shape}")
        if pixels.dtype not in DTYPES:
            raise InvalidInput(f"an image is uint8, uint16 or float32, found {pixels.dtype}")
        if self.orientation not in range(1, 9):
            raise InvalidInput(f"an orientation is 1 … 8, found {self.orientation}")
        pixels = pixels.view()
        pixels.setflags(write=False)
        object.__setattr__(self, "pixels", pixels)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def channels(self) -> int:
        return 1 if self.pixels.ndim == 2 else self.pixels.shape[2]


class Scratch:
    """Arrays by their role, for one thread; fresh memory for 12 MP takes as long as half of decoding them.

    What a role gives is overwritten when the role is asked for again.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Array] = {}

    def array(self, role: str, shape: tuple[int, ...], dtype: DTypeLike) -> Array:
        """Return an array of this shape and type, its content left from the last use."""
        array = self._arrays.get(role)
        if array is None or array.shape != shape or array.dtype != dtype:
            array = self._arrays[role] = np.empty(shape, dtype)
        return array


_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# What NumPy's reader of headers, which are Python, and the ZIP reader raise on damaged files.
_BAD_HEADER = (ValueError, TypeError, SyntaxError, TokenError, EOFError, RecursionError, MemoryError, OverflowError)
_BAD_ARCHIVE = (
    *(
        EOFError,
        KeyError,
        LookupError,
        NotImplementedError,
        OSError,
        OverflowError,
        RuntimeError,
        TypeError,
        ValueError,
    ),
    zlib.error,
)
_PACKED = 100  # a compressed array has fewer times the bytes of its file, or is small
_SMALL = 256 << 20  # bytes


def read_npy(path: Path, kinds: str = "uif", content: bytes | None = None) -> Array:
    """Return the array of a .npy file in this machine's byte order; floating point comes as float32.

    kinds: NumPy's letters of the kinds of numbers that will do. content: of the file, where it has been read already.
    Raises FileError if the file is missing, empty, truncated, of another kind or holds no numbers.
    """
    content = read_bytes(path) if content is None else content
    try:
        values = array_of(content)
    except ValueError as error:
        raise FileError("not a readable NumPy array file", where=str(path)) from error
    if values.dtype.kind not in kinds:
        raise FileError("contains no numeric array", where=str(path))
    with np.errstate(over="ignore", invalid="ignore"):  # of what float32 does not hold
        return values.astype(np.float32 if values.dtype.kind == "f" else values.dtype.newbyteorder("="))


def array_of(content: bytes) -> Array:
    """Return the array in the bytes of a .npy file, read-only; raises ValueError if it is damaged or holds objects."""
    stream = io.BytesIO(content)
    try:
        shape, columns_first, kind = _READERS[np.lib.format.read_magic(stream)](stream)
        count, start = math.prod(shape), stream.tell()
        if kind.hasobject or min(shape, default=0) < 0 or count * kind.itemsize != len(content) - start:
            raise ValueError(f"{shape} of {kind} do not take {len(content) - start} bytes")
        if not count * kind.itemsize:
            return np.empty(shape, kind)
        return np.frombuffer(content, kind, count, start).reshape(shape, order="F" if columns_first else "C")
    except (KeyError, *_BAD_HEADER) as error:
        raise ValueError("a damaged or unknown NumPy header") from error


def arrays_of(content: bytes) -> dict[str, Array]:
    """Return the arrays in the bytes of a .npz file by their names, read-only; raises ValueError if it is damaged."""
    import zipfile  # here, since it takes as long to import as a camera file to read

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [member for member in archive.infolist() if member.filename.endswith(".npy")]
            if sum(member.file_size for member in members) > max(_SMALL, _PACKED * len(content)):
                raise ValueError("archive size exceeds its bytes")
            return {member.filename.removesuffix(".npy"): array_of(archive.read(member)) for member in members}
    except (zipfile.BadZipFile, *_BAD_ARCHIVE) as error:
        raise ValueError("a damaged NumPy archive") from error


def names_in(content: bytes) -> list[str]:
    """Return the names of the arrays in the bytes of a .npz file, none if it is damaged."""
    import zipfile

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return [name.removesuffix(".npy") for name in archive.namelist()]
    except (zipfile.BadZipFile, *_BAD_ARCHIVE):
        return []


def write_npy(path: Path, values: Array) -> None:
    """Write an array as a .npy file, in one step."""
    with replacing(path) as temporary:
        np.save(temporary, values, allow_pickle=False)
