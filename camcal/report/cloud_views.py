"""Viewpoints of a cloud: the camera's view, front, top, side, or any angle."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import radians
from typing import Any

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.parsing import parse_numbers
from camcal.report.cloud_scene import CloudScene

NAMED = ("camera", "front", "top", "side")

_PULLED_BACK = 0.1  # of the distance to the centre
_OPENING = 0.36  # tangent of half the angle of view (40 degrees) where it does not follow from the cloud
_MARGIN = 1.06
_FLATTEST = 0.45  # height over width
_TAIL = 0.002  # share of the points that may be seen outside the picture on either side
_FITS = 6  # the distance settles to a few percent in three
_OBLIQUE = (radians(30), radians(22))


@dataclass(frozen=True)
class View:
    """A place to look from, in a frame x right, y down, z forward.

    target: centre of rotation. azimuth, elevation: radians; at 0, 0 one looks forward, then the viewer goes to the
    right and up. distance: to the target. half_width, half_height: what is to be seen at the target on either side of
    it. parallel: a parallel projection, else a perspective one.
    """

    target: tuple[float, float, float]
    azimuth: float
    elevation: float
    distance: float
    half_width: float
    half_height: float
    parallel: bool = False

    @property
    def axes(self) -> Array:
        """Right, down and forward of the picture, as rows (3, 3)."""
        return axes_of(self.azimuth, self.elevation)

    @property
    def eye(self) -> Array:
        """Where the viewer stands (3,)."""
        eye: Array = np.asarray(self.target) - self.distance * self.axes[2]
        return eye

    def focal(self, size: tuple[int, int]) -> float:
        """Pixels per unit at the target times its distance, such that all that is to be seen is in the picture."""
        wanted = max(self.half_width / size[0], self.half_height / size[1], 1e-12 * self.distance)
        return self.distance / (2 * wanted * _MARGIN)

    def size(self, width: int) -> tuple[int, int]:
        """Return the size of a picture so wide and as high as what is to be seen, within reason and even."""
        shape = min(max(self.half_height / max(self.half_width, 1e-12), _FLATTEST), 1.0)
        return width, round(width * shape / 2) * 2

    def document(self) -> dict[str, Any]:
        return asdict(self)


def axes_of(azimuth: float, elevation: float) -> Array:
    """Return right, down and forward (3, 3) of a viewer who has gone to the right and up by these angles, radians."""
    (sa, ca), (se, ce) = ((np.sin(angle), np.cos(angle)) for angle in (azimuth, elevation))
    return np.array([[ca, 0, sa], [se * sa, ce, -se * ca], [-sa * ce, se, ca * ce]])


def named_views(scene: CloudScene) -> dict[str, View]:
    """Return the views that have a name: camera, front, top and side."""
    middle, half = scene.box.mean(axis=0), np.ptp(scene.box, axis=0) / 2
    target = tuple(middle.tolist())
    reach = 2 * _reach(scene)
    return {
        "camera": _camera(scene),
        "front": View(target, 0.0, 0.0, reach, float(half[0]), float(half[1]), parallel=True),
        "top": View(target, 0.0, radians(90), reach, float(half[0]), float(half[2]), parallel=True),
        "side": View(target, radians(90), 0.0, reach, float(half[2]), float(half[1]), parallel=True),
    }


def _reach(scene: CloudScene) -> float:
    """Return half the diagonal of the box; of a single point, a tenth of its distance to the origin."""
    half, middle = np.ptp(scene.box, axis=0) / 2, scene.box.mean(axis=0)
    return max(float(np.linalg.norm(half)), 0.1 * float(np.linalg.norm(middle)) if not half.any() else 0.0, 1e-9)


def _camera(scene: CloudScene) -> View:
    """Return the view of the camera that saw the cloud, a little pulled back; of others, one from above the corner."""
    if not scene.from_camera:
        return around(scene, *_OBLIQUE)
    depth = scene.median_depth
    x, y = scene.tangents.mean(axis=0).tolist()
    length = float(np.sqrt(x * x + y * y + 1))
    half_width, half_height = (np.ptp(scene.tangents, axis=0) / 2).tolist()
    distance = depth * length * (1 + _PULLED_BACK)
    elevation = float(np.arcsin(y / length))
    target = (x * depth, y * depth, depth)
    return View(target, float(-np.arctan(x)), elevation, distance, half_width * depth, half_height * depth)


def around(scene: CloudScene, azimuth: float, elevation: float, distance: float | None = None) -> View:
    """Return a view from an angle, radians; unless the distance is given, from where the main part fills the picture.

    At a distance that is given the centre is that of the camera's own view, or of the box where no camera saw it.
    """
    if distance is not None:
        centre = _camera(scene).target if scene.from_camera else tuple(scene.box.mean(axis=0).tolist())
        return View(centre, azimuth, elevation, distance, distance * _OPENING, distance * _OPENING)
    axes = axes_of(azimuth, elevation)
    target, distance = scene.box.mean(axis=0), 2 * _reach(scene)
    nearest, half = 0.1 * distance, np.array([_OPENING, _OPENING])
    for _ in range(_FITS):
        low, high = _seen_angles(scene.main_part, target - distance * axes[2], axes)
        target = target + distance * ((low + high) / 2 @ axes[:2])
        half = (high - low) / 2
        distance = max(distance * float(half.max()) / _OPENING, nearest)
    return View(tuple(target.tolist()), azimuth, elevation, distance, *(half * distance).tolist())


def _seen_angles(points: Array, eye: Array, axes: Array) -> tuple[Array, Array]:
    """Return the lowest and the highest tangents, right and down (2,), at which a viewer sees nearly all points."""
    beside = (points - eye) @ axes.T
    before = beside[beside[:, 2] > 1e-9]
    if not len(before):
        return np.full(2, -1.0), np.ones(2)
    low, high = np.quantile(before[:, :2] / before[:, 2:], [_TAIL, 1 - _TAIL], axis=0)
    return low, high


def view_of(text: str, scene: CloudScene) -> View:
    """Return the view of a name, or of AZ,EL or AZ,EL,DIST: degrees, and the unit of the cloud.

    Raises InvalidInput for any other text.
    """
    if text in NAMED:
        return named_views(scene)[text]
    numbers = _numbers(text)
    if len(numbers) not in (2, 3) or abs(numbers[1]) > 90 or not all(length > 0 for length in numbers[2:]):
        raise InvalidInput(
            f"view {text!r} is not one of {', '.join(NAMED)}, nor AZ,EL or AZ,EL,DIST in degrees, EL from -90 to 90"
        )
    return around(scene, radians(numbers[0]), radians(numbers[1]), *numbers[2:])


def _numbers(text: str) -> Sequence[float]:
    try:
        numbers = parse_numbers(text.split(","))
    except ValueError:
        return ()
    return numbers if np.isfinite(numbers).all() else ()


def turn(start: View, angle: float, frames: int) -> list[View]:
    """Return the views of a turn that begins with a view: once round for 360 degrees, to and fro for less (radians)."""
    steps = np.arange(frames) / frames
    full = angle >= 2 * np.pi - 1e-9
    turned = steps * 2 * np.pi if full else angle / 2 * np.sin(2 * np.pi * steps)
    return [replace(start, azimuth=start.azimuth + by) for by in turned.tolist()]
