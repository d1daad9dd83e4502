"""Gray PFM files: 32-bit floating point, rows from the bottom up."""

import re
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.files import read_bytes, replacing

_HEADER = re.compile(rb"Pf\s+(\d{1,9})\s+(\d{1,9})\s+([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s")


def read_pfm(path: Path) -> Array:
    """Return the values (H, W), float32, of a gray PFM file, from the top down.

    The size of the number that tells the byte order by its sign is left alone: Middlebury writes 1/255 there without
    meaning it, and OpenCV, which divides by it, reads disparities 255 times too large.
    Raises FileError if the file is missing, in colour, cut off or no PFM.
    """
    content = read_bytes(path)
    header = _HEADER.match(content)
    if header is None:
        raise FileError("not a gray PFM file (its header is Pf, width, height, byte order)", where=str(path))
    width, height = int(header[1]), int(header[2])
    order = "<f4" if float(header[3]) < 0 else ">f4"
    if len(content) - header.end() != 4 * width * height:
        found = len(content) - header.end()
        raise FileError(f"{width} × {height} pixels take {4 * width * height} bytes, found {found}", where=str(path))
    values = np.frombuffer(content, order, offset=header.end()).reshape(height, width)
    return values[::-1].astype(np.float32)


def write_pfm(path: Path, values: Array) -> None:
    """Write values (H, W) as float32, the lowest byte first, in one step."""
    height, width = values.shape
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(b"Pf\n%d %d\n-1.0\n" % (width, height))
        stream.write(values[::-1].astype("<f4").data)
