"""How far from the principal point a lens forms an image: circular fisheyes leave the corners of the image black."""

from math import hypot, inf
from pathlib import Path

from camcal.cameras.model import Camera
from camcal.cameras.validity import folds_inside
from camcal.errors import CamcalError
from camcal.images.image_circle import MOST_IMAGES, ImageCircleSearch, evenly_spaced
from camcal.tasks.calibration.board_views import BoardViews
from camcal.tasks.calibration.photographs import Reading, read_photograph


def image_reach(camera: Camera, seen: BoardViews, reading: Reading) -> float:
    """Return how far from the principal point the image circle goes, px; inf where there is none or it does not matter.

    It matters where the lens model is not invertible in the whole image. Some of the images are read once more.
    """
    paths = [Path(view.image) for view in seen.detections.views if view.size == camera.image_size]
    paths = [path for path in paths if path.is_file()]
    if seen.table or not folds_inside(camera).folds or not paths:
        return inf
    search = ImageCircleSearch()
    for index in evenly_spaced(len(paths), MOST_IMAGES):
        try:
            search.add(read_photograph(paths[index], reading).gray)
        except CamcalError:  # read before, gone since
            continue
    circle = search.result()
    if circle is None:
        return inf
    return hypot(circle.centre[0] - camera.value("cx"), circle.centre[1] - camera.value("cy")) + circle.radius
