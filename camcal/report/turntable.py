"""Films of a cloud that turns: GIF for any page, MP4 for longer ones."""

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from camcal.arrays import Array
from camcal.errors import FileError, InvalidInput
from camcal.files import replacing
from camcal.report.cloud_labels import write_labels
from camcal.report.cloud_paint import Paint
from camcal.report.cloud_pictures import labels_of, rendered
from camcal.report.cloud_scene import CloudScene
from camcal.report.cloud_views import View

_PER_SECOND = 20  # a GIF counts in hundredths of a second
_CODEC = "mp4v"  # the one that every build of OpenCV can write into an MP4


def frames(
    scene: CloudScene, paint: Paint, views: Sequence[View], size: tuple[int, int], point_size: float = 1.0
) -> Iterator[Array]:
    """Yield the pictures (H, W, 3) of some views, red, green, blue, uint8, with the legend of their colours."""
    for view in views:
        pixels = rendered(scene, paint, view, size, point_size)
        yield write_labels(pixels, labels_of(scene, paint, view, size, "camera")) if paint.scale else pixels


def write(path: Path, pictures: Iterator[Array]) -> None:
    """Write pictures of one size as a film, .gif (endless) or .mp4. Raises FileError if it cannot be written."""
    with replacing(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(temporary, pictures)
        else:
            _write_mp4(temporary, pictures, path)


def _write_gif(path: Path, pictures: Iterator[Array]) -> None:
    """Write with the same 256 colours for all pictures, so that what stands still does not flicker."""
    films = list(pictures)
    sample = Image.fromarray(np.vstack(films[:: max(1, len(films) // 6)]))
    palette = sample.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    first, *rest = (Image.fromarray(one).quantize(palette=palette, dither=Image.Dither.NONE) for one in films)
    first.save(path, "GIF", save_all=True, append_images=rest, duration=1000 // _PER_SECOND, loop=0, optimize=False)


def _write_mp4(path: Path, pictures: Iterator[Array], named: Path) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    if height % 2 or width % 2:
        raise InvalidInput(f"an MP4 has sides of even numbers of pixels, not {width}x{height}", where=str(named))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*_CODEC), _PER_SECOND, (width, height))
    if not writer.isOpened():
        raise FileError("this OpenCV writes no MP4; write a .gif", where=str(named))
    count = 0
    for picture in chain([first], pictures):
        writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
        count += 1
    writer.release()
    if cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) != count:  # OpenCV does not say so
        raise FileError("cannot be written as a whole; the disk may be full", where=str(named))
