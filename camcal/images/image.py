"""The record of one image: its pixels, and what its file said about them; memory for pixels, used again and again."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from camcal.arrays import Array, PixelArray
from camcal.errors import InvalidInput

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
