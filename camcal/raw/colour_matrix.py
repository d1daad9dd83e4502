"""From the colours of the sensor to those of a standard: a 3 × 3 matrix in linear light."""

from pathlib import Path

import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.files import read_bytes
from camcal.parsing import parse_numbers
from camcal.raw.mosaic import Mosaic
from camcal.raw.options import NO_MATRIX

SRGB = "srgb"

# IEC 61966-2-1, table 1: linear sRGB to CIE XYZ, white D65.
XYZ_M_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def colour_matrix(frame: Mosaic, choice: str) -> Array | None:
    """Return the matrix (3, 3) from the balanced red, green, blue of a frame to those asked for; None for none.

    choice: none, srgb (by what the file says of its sensor; gray stays gray), or a text file of nine numbers.
    Raises InvalidInput if the frame says nothing of its sensor or the file is no such matrix, FileError if it is not
    there.
    """
    if choice == NO_MATRIX:
        return None
    if choice != SRGB:
        return read_matrix(Path(choice))
    if frame.camera_M_xyz is None:
        raise InvalidInput("does not say what its sensor's colours are; give a file of nine numbers instead of srgb")
    camera_M_srgb = frame.camera_M_xyz @ XYZ_M_SRGB
    camera_M_srgb /= camera_M_srgb.sum(axis=1, keepdims=True)
    return np.asarray(np.linalg.inv(camera_M_srgb))


def read_matrix(path: Path) -> Array:
    """Return the matrix (3, 3) in a text file: nine numbers, row by row, # begins a comment."""
    try:
        text = read_bytes(path).decode()
    except UnicodeDecodeError as error:
        raise FileError("is no text file; a colour matrix is nine numbers", where=str(path)) from error
    words = " ".join(line.partition("#")[0] for line in text.splitlines()).replace(",", " ").split()
    try:
        numbers = np.array(parse_numbers(words))
    except ValueError as error:
        raise InvalidInput(f"a colour matrix is nine numbers ({error})", where=str(path)) from error
    if numbers.size != 9 or not np.isfinite(numbers).all() or abs(np.linalg.det(numbers.reshape(3, 3))) < 1e-9:
        raise InvalidInput(f"a colour matrix is nine numbers that can be inverted, found {len(words)}", where=str(path))
    return numbers.reshape(3, 3)


def apply_matrix(colour: Array, matrix: Array) -> Array:
    """Return colour (H, W, 3) blue, green, red, float32, behind a matrix (3, 3) of red, green, blue."""
    swapped = np.asarray(matrix[::-1, ::-1], np.float32)
    return np.asarray(colour.reshape(-1, 3) @ swapped.T).reshape(colour.shape)
