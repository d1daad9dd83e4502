"""Pictures of point clouds for machines without a screen: one view, four beside each other, or the frames of a turn."""

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.report.cloud_labels import Labels, write_labels
from camcal.report.cloud_paint import Paint
from camcal.report.cloud_renderer import Drawn, draw, shading
from camcal.report.cloud_scene import CloudScene
from camcal.report.cloud_views import View, view_of

MONTAGE = ("camera", "30,22", "top", "side")

_BACKGROUND = (228, 231, 235)  # white walls stand out from it
_LINE = 2  # pixels between the pictures of a montage
_LIMITS = (32, 8192)  # pixels of a side


def picture(scene: CloudScene, paint: Paint, view: str, size: tuple[int, int], point_size: float = 1.0) -> Array:
    """Return a picture (H, W, 3), red, green, blue, uint8, of a view by its name or angle, with its labels.

    Raises InvalidInput for a view that is none, or a size that cannot be drawn.
    """
    seen = view_of(view, scene)
    return write_labels(rendered(scene, paint, seen, size, point_size), labels_of(scene, paint, seen, size, view))


def montage(scene: CloudScene, paint: Paint, size: tuple[int, int], point_size: float = 1.0) -> Array:
    """Return four views in one picture of a size: the camera's own, one from the side and above, top and side."""
    _require_size(size)
    whole = np.full((size[1], size[0], 3), 200, np.uint8)
    part = ((size[0] - _LINE) // 2, (size[1] - _LINE) // 2)
    for place, view in enumerate(MONTAGE):
        row, column = (place // 2) * (part[1] + _LINE), (place % 2) * (part[0] + _LINE)
        whole[row : row + part[1], column : column + part[0]] = picture(scene, paint, view, part, point_size)
    return whole


def _require_size(size: tuple[int, int]) -> None:
    if not all(_LIMITS[0] <= side <= _LIMITS[1] for side in size):
        raise InvalidInput(f"a picture has sides of {_LIMITS[0]} to {_LIMITS[1]} pixels, not {size[0]}x{size[1]}")


def rendered(scene: CloudScene, paint: Paint, view: View, size: tuple[int, int], point_size: float) -> Array:
    """Return the points of a view (H, W, 3), red, green, blue, uint8, without labels.

    Raises InvalidInput for a size that cannot be drawn.
    """
    _require_size(size)
    drawn = draw(scene, view, size, point_size)
    pixels = np.empty((size[1], size[0], 3), np.uint8)
    pixels[:] = _BACKGROUND
    shown = drawn.index >= 0
    pixels[shown] = _shaded(paint, drawn, shown)
    return pixels


def _shaded(paint: Paint, drawn: Drawn, shown: Array) -> Array:
    light: Array = paint.colours[drawn.index[shown]] * shading(drawn.distance)[shown][:, None]
    return np.rint(light).astype(np.uint8)


def labels_of(scene: CloudScene, paint: Paint, view: View, size: tuple[int, int], name: str) -> Labels:
    """Return what is to be written over a view."""
    caption = name if name in ("front", "top", "side") or (name == "camera" and scene.from_camera) else _angles(view)
    per_unit = view.focal(size) / view.distance if view.parallel else None
    return Labels(caption, scene.unit, per_unit, paint.scale, paint.name)


def _angles(view: View) -> str:
    azimuth, elevation = np.rint(np.degrees([view.azimuth, view.elevation])).astype(int).tolist()
    return f"azimuth {azimuth}°, elevation {elevation}°"
