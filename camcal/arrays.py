"""The types of arrays, and the two checks that every record uses.

Array is an array of any kind; what users receive has the type of its elements. Images are PixelArray.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from camcal.errors import InvalidInput

Array = NDArray[Any]
FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]
PixelArray = NDArray[np.uint8 | np.uint16 | np.float32]
Shape = tuple[int | None, ...]


def require_shape(array: ArrayLike, shape: Shape, name: str, dtype: DTypeLike = np.float64) -> Array:
    """Return `array` as an ndarray of `dtype`, refusing any other shape; None stands for any length.

    Raises InvalidInput naming the array, the shape found and the shape expected.
    """
    result = np.asarray(array, dtype=dtype)
    found = result.shape
    if found != shape and not (
        len(found) == len(shape) and all(want is None or want == have for have, want in zip(found, shape, strict=True))
    ):
        wanted = "(" + ", ".join("N" if n is None else str(n) for n in shape) + ("," if len(shape) == 1 else "") + ")"
        single = f"; give a single one as {name}[None]" if shape[:1] == (None,) and found == shape[1:] else ""
        raise InvalidInput(f"{name} has shape {found}, expected {wanted}{single}")
    return result


def readonly(array: ArrayLike, shape: Shape, name: str, dtype: DTypeLike = np.float64) -> Array:
    """Return a read-only copy of `array` with the given shape and dtype, for the fields of frozen records."""
    result = require_shape(array, shape, name, dtype).copy()
    result.setflags(write=False)
    return result
