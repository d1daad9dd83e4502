"""The points of a cloud that are shown, their attributes, and the viewpoints that they are seen from."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cached_property
from math import radians
from typing import Any

import numpy as np

from camcal.arrays import Array, readonly
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry.pose import rotation_of
from camcal.parsing import parse_numbers
from camcal.stereo.depth import COLOUR, INTENSITY, POSITION, SIGMA, VertexStream

_NEAREST = 1e-12  # of a depth that tangents are taken at
_FARTHEST = 1e15  # of a coordinate; squares of what lies beyond are no float32, and it is no measurement
_SEED = 20240229
_TAIL = 0.005  # share of the points beyond either side of the box
_MARGIN = 1.0  # sizes of the box on either side of it within which points are still shown
_SAMPLE = 50_000
_AS_EVEN = 1.25  # spacings that grow are accepted to if that makes them as even as this
_NEIGHBOURS = 8_000  # points of the sample that tells the spacing
_BACKGROUND = 4.0  # median depths
_WIDEST = 3.0  # tangent; what spreads more than 143 degrees as seen from the origin was not seen by one camera
_IN_FRONT = 0.95  # share of the points in front of the origin, if that is where the camera stood

NAMED = ("camera", "front", "top", "side")

_PULLED_BACK = 0.1  # of the distance to the centre
_OPENING = 0.36  # tangent of half the angle of view (40 degrees) where it does not follow from the cloud
_FRAME_MARGIN = 1.06
_FLATTEST = 0.45  # height over width
_UNSEEN = 0.002  # share of the points that may be seen outside the picture on either side
_FITS = 6  # the distance settles to a few percent in three
_OBLIQUE = (radians(30), radians(22))


@dataclass(frozen=True, eq=False)
class CloudScene:
    """Points (N, 3), float32, in the unit and the frame of their file, in the order of the file.

    colours: (N, 3) red, green, blue, 0 … 255. sigma: (N,) standard deviation of the depth, NaN where it is not known.
    unit: m or mm. frame: in words. total: points of the file. outside: points left out because they are far from all
    others (see `gather`).
    """

    points: Array
    colours: Array | None
    sigma: Array | None
    unit: str
    frame: str
    total: int
    outside: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", readonly(self.points, (None, 3), "points", np.float32))
        count = len(self.points)
        if self.colours is not None:
            object.__setattr__(self, "colours", readonly(self.colours, (count, 3), "colours", np.uint8))
        if self.sigma is not None:
            object.__setattr__(self, "sigma", readonly(self.sigma, (count,), "sigma", np.float32))

    @cached_property
    def view_T_cloud(self) -> Array:  # noqa: N802 - a transform is named a_T_b
        """Rotation (3, 3) to the frame that is examined: x right, y down, z forward; by what the frame says."""
        return rotation_of(self.frame)

    @cached_property
    def seen(self) -> Array:
        """The points (N, 3), float32, x right, y down, z forward."""
        turned: Array = self.points @ self.view_T_cloud.T.astype(np.float32)
        return turned

    @property
    def depth(self) -> Array:
        """Depth along the axis that points forward (N,)."""
        depth: Array = self.seen[:, 2]
        return depth

    @cached_property
    def main_part(self) -> Array:
        """Points (N, 3) of an even sample, x right, y down, z forward, that views are to show.

        Of what a camera saw this leaves out the far background, which would make all else small.
        """
        if not self.from_camera:
            return self._sample
        part: Array = self._sample[self._sample[:, 2] <= _BACKGROUND * self.median_depth]
        return part

    @cached_property
    def median_depth(self) -> float:
        """The depth that half of the points exceed."""
        return float(np.median(self._sample[:, 2]))

    @cached_property
    def _sample(self) -> Array:
        """Points enough to tell quantiles by, x right, y down, z forward."""
        return _sample(self.seen)

    @cached_property
    def box(self) -> Array:
        """Lowest and highest x, y, z (2, 3) of the main part but for a few outliers, x right, y down, z forward."""
        return _box(self.main_part)

    @cached_property
    def from_camera(self) -> bool:
        """Whether the points are in the field of view of a camera at the origin."""
        if np.mean(self._sample[:, 2] > 0) < _IN_FRONT:
            return False
        return bool(np.ptp(self.tangents, axis=0).max() < _WIDEST)

    @cached_property
    def tangents(self) -> Array:
        """Lowest and highest x / z and y / z (2, 2) of all points but a few, as the origin sees them."""
        front = self._sample[self._sample[:, 2] > _NEAREST]
        return _box(front[:, :2] / front[:, 2:]) if len(front) else np.zeros((2, 2))

    @cached_property
    def spacing(self) -> tuple[float, bool]:
        """Typical distance of a point to the next; and whether it is to be multiplied by the distance to the origin.

        The points of a camera stand closer together the nearer they are; those thinned by voxels do not.
        """
        apart, ray = _neighbours(self.seen)
        if self.from_camera and _spread(apart / ray) < _AS_EVEN * _spread(apart):
            return float(np.median(apart / ray)), True
        return float(np.median(apart)), False


def gather(stream: VertexStream, most: int) -> CloudScene:
    """Return what is to be seen of a cloud, at most so many points, taken evenly from all of the file.

    Points that are not finite are none. What is farther from the box of nearly all points than its size
    is left out, and counted: it could not be seen beside the others.
    Raises InsufficientData for a cloud without points.
    """
    picked, total = [], 0
    start = 0
    for block, chosen in _choose(stream, most):
        total += int(np.count_nonzero(_finite(block)))
        kept = block[chosen - start]
        picked.append(kept[_finite(kept)])
        start += len(block)
    if not total:
        raise InsufficientData("the cloud has no points")
    vertices = np.concatenate(picked)
    points = np.stack([vertices[axis] for axis in POSITION], axis=1)
    low, high = _box(_sample(points))
    reach = _MARGIN * max(float((high - low).max()), 1e-6 * float(np.abs(points).max()))
    near: Array = ((points >= low - reach) & (points <= high + reach)).all(axis=1)
    return CloudScene(
        points[near],
        _colours(vertices[near]),
        sigma=vertices[SIGMA][near] if SIGMA in (stream.type.names or ()) else None,
        unit=stream.unit,
        frame=stream.frame,
        total=total,
        outside=int(np.count_nonzero(~near)),
    )


def _choose(stream: VertexStream, most: int) -> Iterator[tuple[Array, Array]]:
    """Yield every block with the places in the stream, rising, of what is kept of it."""
    places = evenly(stream.count, most)
    start = 0
    for block in stream.blocks:
        first, last = np.searchsorted(places, [start, start + len(block)])
        yield block, places[first:last]
        start += len(block)


def evenly(count: int, most: int) -> Array:
    """Return at most so many places 0 … count - 1, rising: one at random in each of equal stretches.

    A regular step would draw stripes over the rows of an image.
    """
    if count <= most:
        return np.arange(count)
    edges = np.linspace(0, count, most + 1)
    inside = np.random.default_rng(_SEED).random(most)
    places: Array = np.minimum((edges[:-1] + inside * np.diff(edges)).astype(np.int64), count - 1)
    return places


def _finite(vertices: Array) -> Array:
    with np.errstate(invalid="ignore"):
        finite: Array = np.all([np.abs(vertices[name]) < _FARTHEST for name in ("x", "y", "z")], axis=0)
    return finite


def _colours(vertices: Array) -> Array | None:
    """Return red, green, blue (N, 3) of vertices with colour or intensity."""
    names = vertices.dtype.names or ()
    if set(COLOUR) <= set(names):
        return np.stack([vertices[name] for name in COLOUR], axis=1)
    if INTENSITY in names:
        light = np.rint(np.clip(np.nan_to_num(vertices[INTENSITY]), 0, 1) * 255).astype(np.uint8)
        return np.repeat(light[:, None], 3, axis=1)
    return None


def _sample(values: Array) -> Array:
    """Return rows enough to tell quantiles by."""
    sample: Array = values[evenly(len(values), _SAMPLE)]
    return sample


def _box(values: Array) -> Array:
    return np.quantile(values.astype(np.float64), [_TAIL, 1 - _TAIL], axis=0)


def _neighbours(points: Array) -> tuple[Array, Array]:
    """Return how far some of the points (N, 3) are from the next, and from the origin.

    Neighbours are found in an even sample; on surfaces, distances grow with the root of the share left out.
    """
    from scipy.spatial import KDTree

    if len(points) < 2:
        return np.zeros(1), np.ones(1)
    sample = points[evenly(len(points), _NEIGHBOURS)].astype(np.float64)
    # The fourth neighbour is one spacing away on a square grid, and 1.1 times the mean spacing among random points.
    fourth = min(4, len(sample) - 1)
    apart = np.asarray(KDTree(sample).query(sample, [fourth + 1])[0])[:, 0]
    return apart * np.sqrt(len(sample) / len(points)), np.linalg.norm(sample, axis=1)


def _spread(values: Array) -> float:
    """Return the width of what holds the middle half of values that are not negative, as a ratio's logarithm."""
    quarter, rest = np.quantile(np.log(np.maximum(values, np.finfo(np.float64).tiny)), [0.25, 0.75])
    return float(rest - quarter)


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
        return self.distance / (2 * wanted * _FRAME_MARGIN)

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
    low, high = np.quantile(before[:, :2] / before[:, 2:], [_UNSEEN, 1 - _UNSEEN], axis=0)
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
