"""The image circle of a camera, measured in some of the searched images."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from camcal.arrays import Array
from camcal.cameras.validity import ImageCircle
from camcal.errors import CamcalError
from camcal.formats.camera_file import CameraEntry
from camcal.images.image_circle import MOST_IMAGES, ImageCircleSearch, evenly_spaced
from camcal.raw.options import ImageReadOptions
from camcal.raw.reading import read_detection_image
from camcal.targets.detection import BoardDetection, Detections
from camcal.tasks.calibration.mixed_sizes import usual_size
from camcal.tasks.calibration.video_frames import Video


def with_circle(
    detections: Detections,
    videos: Sequence[Video],
    reading: ImageReadOptions,
    files: Mapping[str, Path] = MappingProxyType({}),
) -> Detections:
    """Return what was found in images of one camera with its image circle, if the images show one.

    videos: the videos that frames among the images are from. files: the images whose names are not their paths. Some
    images are read once more, until it is clear that there is no circle.
    """
    circle = _measured(detections.views, videos, reading, files)
    camera = detections.views[0].camera if len(detections) else ""
    return detections if circle is None else replace(detections, circles={camera: circle})


def known_circle(detections: Detections, guess: CameraEntry | None) -> ImageCircle | None:
    """Return the image circle that goes with detections of one camera, or else with a camera file's entry of it.

    None if neither has one, or it does not fit these detections: it is of images of another size, or points of a board
    lie outside of it, where there must be light.
    """
    cameras = {view.camera for view in detections.views}
    circle = detections.circles.get(cameras.pop()) if len(cameras) == 1 else None
    if circle is None and guess is not None:
        circle = guess.image_circle
    return circle if circle is not None and _fits(circle, detections.views) else None


def circle_lines(circle: ImageCircle | None) -> tuple[str, ...]:
    """Return the line of the report on an image circle, none without one."""
    return () if circle is None else (circle.words,)


def _measured(
    views: Sequence[BoardDetection], videos: Sequence[Video], reading: ImageReadOptions, files: Mapping[str, Path]
) -> ImageCircle | None:
    """Return the image circle that images show, None if they show none or points of a board lie outside of it."""
    size = usual_size(views)
    names = [view.image for view in views if view.size == size]
    names = [names[index] for index in evenly_spaced(len(names), MOST_IMAGES)]
    search = ImageCircleSearch()
    for gray in _images(names, videos, reading, files):
        if gray.shape[::-1] != size:  # of the file; the view was made to fit
            continue
        search.add(gray)
        if search.ruled_out:
            return None
    found = search.result()
    if found is None or not _fits(found, views):
        return None
    return ImageCircle(found.image_size, found.centre, found.radius)


def _fits(circle: ImageCircle, views: Sequence[BoardDetection]) -> bool:
    """Return whether a circle is of images of the usual size, and holds all points that were found in these."""
    size = usual_size(views)
    inside = (circle.contains(view.pixels).all() for view in views if view.size == size)
    return circle.image_size == size and all(inside)


def _images(
    names: Sequence[str], videos: Sequence[Video], reading: ImageReadOptions, files: Mapping[str, Path]
) -> Iterator[Array]:
    """Yield the gray images (H, W) of that name that can be read, frames of videos last."""
    from_videos = frozenset(name for video in videos for name in video.names)
    for name in names:
        if name in from_videos:
            continue
        try:
            yield read_detection_image(files.get(name, Path(name)), reading).gray
        except CamcalError:  # gone since
            continue
    for video in videos:
        yield from (frame.image.pixels for frame in video.only(frozenset(names)).frames())
