"""Reading disparity maps: images (8-bit, 16-bit with a scale, float TIFF, PFM) and NumPy arrays."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camcal.arrays import Array, readonly
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.images.load import load
from camcal.images.npy import read_npy

KITTI_SCALE = 256.0  # 16-bit disparity is in 1/256 px by the convention of the KITTI benchmark

_PFM_HEADER = re.compile(rb"Pf\s+(\d+)\s+(\d+)\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s")


@dataclass(frozen=True, eq=False)
class DisparityMap:
    """Disparity (H, W), float32 pixels, left minus right, and the counts per pixel by which the file was divided.

    What means "no match" is left as the file has it: 0, a negative number, NaN or infinity.
    """

    values: Array
    scale: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", readonly(self.values, (None, None), "disparity", np.float32))


def read(path: Path, scale: float | None = None) -> DisparityMap:
    """Return the disparity map of a file; the scale defaults to 256 for 16-bit files and to 1 for all others.

    Raises FileError if the file cannot be read, InvalidInput if it has several channels or the scale is not positive.
    """
    values = _read_values(path)
    if values.ndim != 2 or values.size == 0:
        raise InvalidInput(f"a disparity map has rows and columns, this has the shape {values.shape}", where=str(path))
    if scale is None:
        scale = KITTI_SCALE if values.dtype == np.uint16 else 1.0
    if not (np.isfinite(scale) and scale > 0):
        raise InvalidInput(f"the scale of a disparity map must be positive, found {scale:g}")
    return DisparityMap(values.astype(np.float32) / np.float32(scale), scale)


def _read_values(path: Path) -> Array:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path)
    return _read_pfm(path) if suffix == ".pfm" else load(path).pixels


def _read_pfm(path: Path) -> Array:
    """Return the values of a gray PFM file, whose rows stand from the bottom up.

    The size of the number that tells the byte order by its sign is left alone: Middlebury writes 1/255 there without
    meaning it, and OpenCV, which divides by it, reads disparities 255 times too large.
    """
    content = read_bytes(path)
    header = _PFM_HEADER.match(content)
    if header is None:
        raise FileError("not a gray PFM file (its header is Pf, width, height, byte order)", where=str(path))
    width, height = int(header[1]), int(header[2])
    order = "<f4" if float(header[3]) < 0 else ">f4"
    if len(content) - header.end() != 4 * width * height:
        found = len(content) - header.end()
        raise FileError(f"{width} × {height} pixels take {4 * width * height} bytes, found {found}", where=str(path))
    values = np.frombuffer(content, order, offset=header.end()).reshape(height, width)
    return values[::-1].astype(np.float32)
