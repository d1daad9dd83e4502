"""NumPy's own file format, for frames and maps that no image format holds."""

from io import BytesIO
from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.files import read_bytes, replacing


def read_npy(path: Path, kinds: str = "uif") -> Array:
    """Return the array of a .npy file in this machine's byte order; floating point comes as float32.

    kinds: NumPy's letters of the kinds of numbers that will do.
    Raises FileError if the file is missing, empty, truncated, of another kind or holds no numbers.
    """
    try:
        values: Array = np.load(BytesIO(read_bytes(path)), allow_pickle=False)
    except (ValueError, EOFError, MemoryError) as error:  # a header may promise more than any memory holds
        raise FileError("not a NumPy array file that can be read", where=str(path)) from error
    if not isinstance(values, np.ndarray) or values.dtype.kind not in kinds:
        raise FileError("holds no plain array of numbers", where=str(path))
    return values.astype(np.float32 if values.dtype.kind == "f" else values.dtype.newbyteorder("="), copy=False)


def write_npy(path: Path, values: Array) -> None:
    """Write an array as a .npy file, in one step."""
    with replacing(path) as temporary:
        np.save(temporary, values, allow_pickle=False)
