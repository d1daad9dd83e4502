"""Limits of the image size, checked before memory is allocated for a size stated in a header."""

import os
from pathlib import Path

from camcal.errors import FileError, InvalidInput

LONGEST_SIDE = 1 << 20  # pixels, of images that OpenCV reads
DEFAULT_MAX_PIXELS = 300_000_000
VARIABLE = "OPENCV_IO_MAX_IMAGE_PIXELS"  # OpenCV's own; worker processes inherit it


def set_default() -> None:
    """Let the limit hold for OpenCV too, which reads it when it is imported; one in the environment stays."""
    os.environ.setdefault(VARIABLE, str(DEFAULT_MAX_PIXELS))


def set_max_pixels(count: int) -> None:
    """Set the limit for this process and those it starts."""
    os.environ[VARIABLE] = str(count)


def max_pixels() -> int:
    """Return how many pixels an image may have."""
    said = os.environ.get(VARIABLE, "")
    return int(said) if said.isascii() and said.isdigit() else DEFAULT_MAX_PIXELS


def require_view(size: tuple[int, int]) -> None:
    """Raise InvalidInput if a view of `size` (width, height) has more pixels than are allowed, or too long a side."""
    width, height = size
    if max(size) > LONGEST_SIDE:
        raise InvalidInput(f"{width}x{height} has a side of more than {LONGEST_SIDE} pixels, which is the limit")
    if width * height > max_pixels():
        megapixels, allowed = width * height / 1e6, max_pixels() / 1e6
        message = f"a view of {width}x{height} has {megapixels:.0f} million pixels, more than --max-pixels {allowed:g}"
        raise InvalidInput(f"{message}; increase it if that is wanted")


def require_pixels(size: tuple[int, int], path: Path) -> None:
    """Raise FileError if an image of `size` (width, height) has more pixels than are allowed, or none."""
    width, height = size
    if width < 1 or height < 1:
        raise FileError(f"invalid image size {width} x {height}: damaged header", where=str(path))
    if width * height > max_pixels():
        megapixels, allowed = width * height / 1e6, max_pixels() / 1e6
        message = f"{width} x {height} are {megapixels:.0f} million pixels, more than --max-pixels {allowed:g}"
        raise FileError(f"{message}; increase it if the header is right", where=str(path))
