"""Reading videos frame by frame, as the sensor saw them."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.images import limits
from camcal.images.image import Image

BARE_SUFFIXES = frozenset({".mjpeg", ".mjpg", ".h264", ".264", ".h265", ".265", ".hevc"})  # pictures without times

_ORIENTATIONS = {0: 1, 90: 6, 180: 3, 270: 8}  # degrees to turn clockwise for looking at it → EXIF
_LEAST = 0.9  # of the frames a file announces; the announcement may be off by a few


def frames(path: Path) -> Iterator[Image]:
    """Yield the frames of a video in order; how to turn them is noted in their orientation and never applied.

    Raises FileError if the file is missing or no video, and after the last frame if many are missing.
    """
    with _opened(path) as capture:
        yield from _read(path, capture)


def frame_name(video: Path, number: int) -> str:
    """Return how a frame of a video is named, as `undistort` names the files it makes of them: clips/movie_000012."""
    return video.with_name(f"{video.stem}_{number:06d}").as_posix()


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    if not path.is_file() or path.stat().st_size == 0:
        raise FileError("is empty" if path.is_file() else "no such file", where=str(path))
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise FileError("not a video that can be read; it may be cut off", where=str(path))
        sides = (capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        width, height = map(int, sides)
        limits.require_pixels((width, height), path)
        yield capture
    finally:
        capture.release()


def stamps(path: Path) -> Array | None:
    """Return the times (N,) s of a video's frames as its file tells them, None if it tells none.

    Raises FileError if the file is missing or no video.
    """
    with _opened(path) as capture:
        times = []
        while capture.grab():
            times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    told = path.suffix.lower() not in BARE_SUFFIXES and len(times) > 1 and max(times) > min(times)
    return np.array(times) if told else None


def _read(path: Path, capture: cv2.VideoCapture) -> Iterator[Image]:
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    turned = _ORIENTATIONS.get(int(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360, 1)
    announced = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    count = 0
    while True:
        there, pixels = capture.read()
        if not there:
            break
        count += 1
        yield Image(pixels, turned)
    if count == 0 or count < _LEAST * announced:
        raise FileError(f"ends after {count} of {max(announced, 0)} frames; it may be cut off", where=str(path))
