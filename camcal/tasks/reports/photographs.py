"""The photographs of a report's thumbnails, read again from the images and videos as far as these are there."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from camcal.arrays import Array
from camcal.errors import CamcalError
from camcal.raw.detection_image import read_detection_image
from camcal.raw.options import ImageReadOptions
from camcal.report.page.thumbnails import MOST, photo_key, photograph
from camcal.targets.detection import BoardDetection
from camcal.tasks.calibration.video_frames import Video


def photographs(
    images: Sequence[str],
    views: Sequence[BoardDetection],
    reading: ImageReadOptions,
    places: Mapping[str, Path],
    videos: Sequence[Video] = (),
    most: int = MOST,
) -> dict[str, str]:
    """Return the photographs of the first `most` images as data URIs by `photo_key`.

    places: the images whose names are not their paths. videos: those whose frames are among the images. Images that are
    gone and those that were made to fit the size of the others have none.
    """
    by_name = {view.image: view for view in views}
    found = {}
    for image, gray in _grays(images[:most], reading, places, videos):
        view = by_name[image]
        if gray.shape[::-1] == view.size:
            found[photo_key(view.camera, image)] = photograph(gray)
    return found


def _grays(
    images: Sequence[str], reading: ImageReadOptions, places: Mapping[str, Path], videos: Sequence[Video]
) -> Iterator[tuple[str, Array]]:
    """Yield the images (H, W) uint8 that can be read under their names, frames of videos last."""
    for image in images:
        path = places.get(image, Path(image))
        with suppress(CamcalError, OSError):
            if path.is_file():
                yield image, read_detection_image(path, reading).gray
    for video in videos:
        yield from ((frame.name, frame.image.pixels) for frame in video.only(images).frames())
