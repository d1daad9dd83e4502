"""Reading videos, and image topics of bags, frame by frame without rotation; sharpness of frames and motion between."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from camcal.arrays import Array
from camcal.errors import FileError
from camcal.images import bag
from camcal.images.image import Image
from camcal.images.options import require_pixels
from camcal.images.videos import address_of
from camcal.urls import local

BARE_SUFFIXES = frozenset({".mjpeg", ".mjpg", ".h264", ".264", ".h265", ".265", ".hevc"})  # pictures without times
PIXELS = 0.4e6  # of the reduced copies on which frames are compared

_ORIENTATIONS = {0: 1, 90: 6, 180: 3, 270: 8}  # degrees to turn clockwise for looking at it → EXIF
_LEAST = 0.9  # of the frames a file announces; the announcement may be off by a few
_WINDOW = (21, 21)
_LEVELS = 4  # halvings of the copies: things may move by 21 · 2⁴ / 2 pixels of a copy
_RETURN = 0.5  # px of a copy from where a point was to where tracking there and back ends, at most
_FEWEST = 4


def frames(path: Path) -> Iterator[Image]:
    """Yield the frames of a video in order; how to turn them is noted in their orientation and never applied.

    Raises FileError if the file is missing or no video, and after the last frame if many are missing.
    """
    if address_of(path):
        yield from bag.frames(path)
        return
    with _open(path) as capture:
        yield from _read(path, capture)


def frame_name(video: Path, number: int) -> str:
    """Return how a frame of a video is named, as `undistort` names the files it makes of them: clips/movie_000012."""
    return video.with_name(f"{video.stem}_{number:06d}").as_posix()


@contextmanager
def _open(path: Path) -> Iterator[cv2.VideoCapture]:
    if not path.is_file() or path.stat().st_size == 0:
        raise FileError("is empty" if path.is_file() else "no such file", where=str(path))
    capture = cv2.VideoCapture(str(local(path)))
    try:
        if not capture.isOpened():
            raise FileError("not a readable video, or truncated", where=str(path))
        sides = (capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        width, height = map(int, sides)
        require_pixels((width, height), path)
        yield capture
    finally:
        capture.release()


def stamps(path: Path) -> Array | None:
    """Return the times (N,) s of a video's frames from its file, of a topic by its messages; None if it has none.

    Raises FileError if the file is missing or no video.
    """
    if address_of(path):
        return bag.stamps(path)
    with _open(path) as capture:
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
        yield Image(np.asarray(pixels, np.uint8), turned)
    if count == 0 or count < _LEAST * announced:
        raise FileError(f"ends after {count} of {max(announced, 0)} frames; the file may be truncated", where=str(path))


def reduced(gray: Array) -> Array:
    """Return a copy (h, w) of an image (H, W) uint8, smaller by the least whole factor that leaves at most PIXELS."""
    factor = math.ceil(math.sqrt(gray.size / PIXELS))
    if factor <= 1:
        return gray
    height, width = (length // factor for length in gray.shape)
    whole = gray[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def focus(copy: Array) -> float:
    """Return the mean squared gradient of a reduced copy (h, w) uint8, gray levels² / px².

    Of frames that show the same thing the sharpest one has most; it says nothing about frames of different things.
    Source: Krotkov, Focusing, International Journal of Computer Vision 1, 1987 (the Tenengrad measure).
    """
    slopes = [cv2.Sobel(copy, cv2.CV_32F, *order, ksize=3, scale=1 / 8) for order in ((1, 0), (0, 1))]
    return sum(float(cv2.norm(slope, cv2.NORM_L2SQR)) for slope in slopes) / copy.size


def motion(before: Array, after: Array, pixels: Array, scale: float) -> float:
    """Return how far points (N, 2) of a frame have moved since the frame before, median px; infinite if none is met.

    before, after: copies (h, w) uint8 of both frames; scale: pixels of the frame per pixel of a copy.
    Source: Lucas and Kanade 1981 on pyramids; points that do not come back when tracked there and back do not count.
    """
    start = ((pixels + 0.5) / scale - 0.5).astype(np.float32).reshape(-1, 1, 2)
    there, met, _ = cv2.calcOpticalFlowPyrLK(
        after, before, start, np.empty_like(start), winSize=_WINDOW, maxLevel=_LEVELS
    )
    back, met_again, _ = cv2.calcOpticalFlowPyrLK(
        before, after, there, np.empty_like(there), winSize=_WINDOW, maxLevel=_LEVELS
    )
    followed = np.asarray(met).ravel().astype(bool) & np.asarray(met_again).ravel().astype(bool)
    kept = followed & (np.linalg.norm(back - start, axis=-1).ravel() < _RETURN)
    if kept.sum() < _FEWEST:
        return float("inf")
    return float(np.median(np.linalg.norm((there - start)[kept], axis=-1))) * scale
