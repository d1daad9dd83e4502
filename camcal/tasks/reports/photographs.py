"""The photographs of a report's thumbnails, read again from the images as far as these are there."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from camcal.errors import CamcalError
from camcal.raw.detection_image import read_detection_image
from camcal.raw.options import ImageReadOptions
from camcal.report.page.thumbnails import MOST, photo_key, photograph
from camcal.targets.detection import BoardDetection


def photographs(
    images: Sequence[str],
    views: Sequence[BoardDetection],
    reading: ImageReadOptions,
    places: Mapping[str, Path],
    most: int = MOST,
) -> dict[str, str]:
    """Return the photographs of the first `most` images as data URIs by `photo_key`.

    places: the images whose names are not their paths. Frames of videos, images that are gone and those that were made
    to fit the size of the others have none.
    """
    by_name = {view.image: view for view in views}
    found = {}
    for image in images[:most]:
        view, path = by_name[image], places.get(image, Path(image))
        with suppress(CamcalError, OSError):
            if not path.is_file():
                continue
            gray = read_detection_image(path, reading).gray
            if gray.shape[::-1] == view.size:
                found[photo_key(view.camera, image)] = photograph(gray)
    return found
