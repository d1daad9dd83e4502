"""The geometry of a rectified pair from two cameras of any lenses: axes, projection, field of view and focal length.

With it the maps of the pair, which are made once, for any number of pairs of images.

The x or y axis of the pair is the baseline, in the direction that turns the images least, those of the first camera
before all; z is the mean optical axis across it, or the middle of the common field.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array, BoolArray, Float32Array, PixelArray
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, replace
from camcal.errors import InsufficientData, InvalidInput
from camcal.geometry.pose import Pose
from camcal.images.remap import Maps, build_maps
from camcal.messages import Message
from camcal.records import Brief
from camcal.stereo.options import AUTO, RectifiedViewOptions
from camcal.stereo.rectify.field import CommonField, Interval, Viewer, arc, common_field, directions_of, extent
from camcal.stereo.rectify.record import AXES, CYLINDRICAL, LATLON, PINHOLE, Rectification
from camcal.stereo.rectify.window import Region, Window, window_of

KEPT = 0.85  # share of the common field that is to be kept
_KEPT_OBLIQUE = 0.90  # by pairs that may look along their baseline; the grid is coarse near it
_WIDEST = {PINHOLE: np.radians(52), CYLINDRICAL: np.radians(58)}  # from the middle, where the projection is chosen
_AXIAL, _OBLIQUE = np.radians(15), np.radians(65)  # of the mean view from the baseline
_TURNED = 0.05  # of an image, whose content may be turned by more than 90°
_ROTATED = 50.0  # degrees, from which people and programs that look at the images are surprised
_NEAR = 0.75  # baselines to where the axes meet, below which some of the points there lie beyond the images
_CHECKED, _STEP = 24, 0.5  # places a side where that is checked, and pixels to the next ones
_ALL_AROUND = np.radians(250)  # of φ, beyond which images are turned in a part
_FAINT = (0.05, 0.1, 0.2, 0.4)
_BEHIND = np.radians(100)  # φ of lenses that see behind them all around, to both sides
_OFF_AXIS = np.radians(5)  # of the middle of the field from the mean optical axis, beyond which it becomes the axis

DEFAULTS = RectifiedViewOptions()


@dataclass(frozen=True, eq=False)
class _Frame:
    """The pair in its axes: names and cameras, left (or upper) first, and the baseline, m."""

    names: tuple[str, str]
    left: Viewer
    right: Viewer
    baseline: float
    swapped: bool

    @property
    def along(self) -> int:
        return self.left.along

    @property
    def view_angle(self) -> float:
        """The angle (rad) between the mean optical axis and the baseline, 0 … π/2."""
        forward = self.left.rect_R_camera[:, 2] + self.right.rect_R_camera[:, 2]
        return float(np.arctan2(np.hypot(forward[1 - self.along], forward[2]), abs(forward[self.along])))

    @property
    def described(self) -> str:
        """What kind of pair it is, for one that looks along its baseline or obliquely to it."""
        kind = "axial" if self.view_angle < _AXIAL else "oblique"
        first, second = self.names[::-1] if self.swapped else self.names
        return f"{kind} pair: {first} and {second} look {np.degrees(self.view_angle):.0f}° off their baseline"

    def axial(self) -> InsufficientData:
        """Return the error of a pair that cannot be rectified."""
        return InsufficientData(
            f"{self.described}, so that the lines of corresponding points meet in the images: rectification would turn "
            "a part of them"
        )

    def turned(self, about: float) -> "_Frame":
        """Return it with the optical axis turned about the baseline by an angle φ."""
        sine, cosine = np.sin(about), np.cos(about)
        rotation = np.eye(3)
        across = 1 - self.along
        rotation[across, across] = rotation[2, 2] = cosine
        rotation[across, 2], rotation[2, across] = -sine, sine
        return replace(self, left=self.left.turned(rotation), right=self.right.turned(rotation))


def plan_rectification(
    cameras: Mapping[str, Camera],
    right_T_left: Pose,
    options: RectifiedViewOptions = DEFAULTS,
    circles: Mapping[str, ImageCircle | None] | None = None,
) -> Rectification:
    """Return how the images of two cameras are rectified, with warnings of what that costs.

    cameras: two by their names, of any lens models. right_T_left: the pose of the first camera in the second one, m.
    circles: image circles by the names of cameras, beyond which there is no image.
    Raises InvalidInput for another number of cameras or a projection that cannot hold the field, InsufficientData for a
    pair that has no common field or looks along its baseline.
    """
    if len(cameras) != 2:
        raise InvalidInput(f"a pair is two cameras, found {len(cameras)}")
    best, own = _quarters(cameras, right_T_left)
    if best != own:
        with suppress(InsufficientData):  # parts of the first camera's images may be turned too far
            return _planned(_frame(cameras, right_T_left, circles or {}, best), options)
    return _planned(_frame(cameras, right_T_left, circles or {}, own), options)


def _planned(frame: _Frame, options: RectifiedViewOptions) -> Rectification:
    field = common_field(frame.left, frame.right)
    _require_common(field, frame)
    rows = _rows(field, frame)
    if abs(rows.middle) > _OFF_AXIS:
        frame = frame.turned(rows.middle)
        field = common_field(frame.left, frame.right)
        _require_common(field, frame)
        rows = _rows(field, frame)
    region = _region(field, rows, frame.along, options)
    projection = _projection(region) if options.projection == AUTO else options.projection
    window = window_of((frame.left, frame.right), field, region, projection, options)
    found = _record(frame, window)
    by_user = options.fov_deg is not None or options.alpha < 1 or options.projection != AUTO
    if window.kept < _KEPT_OBLIQUE and frame.view_angle < _OBLIQUE and not by_user:
        raise InsufficientData(
            f"{frame.described}: rectified images would hold {100 * window.kept:.0f} % of the common field, as it "
            "reaches to the baseline itself; give --fov HxV for a part of it"
        )
    turns = [_turns(frame.left, found.left_camera), _turns(frame.right, found.right_camera)]
    first = turns[frame.swapped]
    if not len(first) or np.mean(np.abs(first) > np.pi / 2) > _TURNED:
        raise frame.axial()
    return replace(found, warnings=(*found.warnings, *_unusual(frame, field, turns)))


def _turns(viewer: Viewer, camera: Camera) -> Array:
    """Return by which angles (N,), rad, what a camera sees is turned all over its rectified images."""
    grid = np.meshgrid(*((np.arange(_CHECKED) + 0.5) / _CHECKED * (side - 1) for side in camera.image_size))
    here = np.column_stack([axis.ravel() for axis in grid])
    places = [
        viewer.pixels(directions_of(camera.unproject(here + step).directions, viewer.along))
        for step in (np.zeros(2), np.array([_STEP, 0]), np.array([0, _STEP]))
    ]
    right, down = ((each - places[0]) / np.linalg.norm(each - places[0], axis=1, keepdims=True) for each in places[1:])
    turns = np.arctan2(right[:, 1] - down[:, 0], right[:, 0] + down[:, 1])
    return np.asarray(turns[np.isfinite(turns)])


def _record(frame: _Frame, window: Window) -> Rectification:
    found = Rectification(
        window.projection,
        AXES[frame.along],
        *frame.names,
        frame.left.rect_R_camera,
        frame.right.rect_R_camera,
        window.size,
        window.focal,
        window.centres[0],
        window.centres[1],
        frame.baseline,
        swapped=frame.swapped,
        kept=window.kept,
    )
    return replace(found, warnings=tuple(_warnings(frame, window)))


def _warnings(frame: _Frame, window: Window) -> list[Message]:
    """Return what the user is to know: cameras the other way round, and what is lost of the common field."""
    found = []
    if frame.swapped:
        first, second = frame.names
        side = ("left of", "above")[frame.along]
        text = f"{first} is {side} {second}: the pair is written in this order, so that disparities are positive"
        found.append(Message("exchanged_cameras", text))
    if window.kept < KEPT:
        text = f"{100 * window.kept:.0f} % of the common field kept: {window.reason}"
        found.append(Message("field_not_kept", text, {"kept": window.kept}))
    return found


def _unusual(frame: _Frame, field: CommonField, turns: Sequence[Array]) -> Iterator[Message]:
    """Yield warnings of images that are rotated, and of cameras whose axes meet next to them."""
    for name, each in zip(frame.names, turns, strict=True):
        angle = float(np.degrees(np.median(np.abs(each)))) if len(each) else 0.0
        if angle > _ROTATED:
            text = f"rectified images of {name} are rotated by {angle:.0f}° relative to the camera's, as it is mounted"
            yield Message("rotated_images", text, {"rotation_deg": angle})
    meeting = min(1.5 / field.near, _nearest_approach(frame))
    if meeting < _NEAR:
        text = f"optical axes meet at {meeting:.2f} baselines: parts of the common field may be outside the images"
        yield Message("converging_cameras", text, {"baselines": meeting})


def _nearest_approach(frame: _Frame) -> float:
    """Return how far from the baseline, in baselines, optical axes pass each other; infinite where they do not."""
    axes = np.column_stack([frame.left.rect_R_camera[:, 2], -frame.right.rect_R_camera[:, 2]])
    lengths, *_ = np.linalg.lstsq(axes, np.eye(3)[frame.along], rcond=None)
    if np.min(lengths) <= 0:
        return np.inf
    return float(np.min(lengths * np.linalg.norm(np.delete(axes, frame.along, axis=0), axis=0)))


def _frame(
    cameras: Mapping[str, Camera], right_T_left: Pose, circles: Mapping[str, ImageCircle | None], quarters: int
) -> _Frame:
    """Return the axes of the pair; z is the mean optical axis, across the baseline. quarters: as `_quarters`."""
    first, second = cameras
    centre, baseline = _baseline(cameras, right_T_left)
    along, swapped = quarters % 2, quarters >= 2
    axis = (-centre if swapped else centre) / baseline
    rotations = {first: np.eye(3), second: right_T_left.rotation.T}  # first_R_camera
    forward = rotations[first][:, 2] + rotations[second][:, 2]
    across = forward - (forward @ axis) * axis
    length = float(np.linalg.norm(across))
    if length > 1e-6:
        z = across / length
    else:  # cameras that look straight along the baseline
        z = np.cross(axis, np.eye(3)[1 - along])
        z /= np.linalg.norm(z)
    axes = (axis, np.cross(z, axis), z) if along == 0 else (np.cross(axis, z), axis, z)
    rect_R_first = np.array(axes)
    order = (second, first) if swapped else (first, second)
    left, right = (Viewer(cameras[name], circles.get(name), rect_R_first @ rotations[name], along) for name in order)
    frame = _Frame(order, left, right, baseline, swapped)
    if length < np.sin(_AXIAL) * np.linalg.norm(forward):
        raise frame.axial()
    return frame


def _baseline(cameras: Mapping[str, Camera], right_T_left: Pose) -> tuple[Array, float]:
    """Return the centre (3,) of the second camera in the axes of the first, and the baseline, m."""
    centre = right_T_left.inverse().translation
    baseline = float(np.linalg.norm(centre))
    if not baseline > 0:
        first, second = cameras
        raise InsufficientData(f"{first} and {second} are at one place: without a baseline there is no depth")
    return centre, baseline


def _quarters(cameras: Mapping[str, Camera], right_T_left: Pose) -> tuple[int, int]:
    """Return by how many quarter turns the x axis is to be turned to the baseline's direction: what turns the images
    of both cameras least, the first one's before all, and what turns the first one's least.
    """
    centre, _ = _baseline(cameras, right_T_left)
    seen = centre, right_T_left.rotation @ centre
    left = np.array([np.arctan2(each[1], each[0]) - np.arange(4) * np.pi / 2 for each in seen])
    own, other = np.abs(np.arctan2(np.sin(left), np.cos(left)))
    return int(np.argmin(np.round(own + other / 2, 9))), int(np.argmin(np.round(own, 9)))


def _require_common(field: CommonField, frame: _Frame) -> None:
    if field.is_empty:
        first, second = frame.names
        axes = frame.left.rect_R_camera[:, 2] @ frame.right.rect_R_camera[:, 2]
        angle = np.degrees(np.arccos(np.clip(axes, -1, 1)))
        raise InsufficientData(
            f"{first} and {second} have no common field of view: their optical axes are {angle:.0f}° apart"
        )


def _rows(field: CommonField, frame: _Frame) -> Interval:
    """Return the φ to be shown: those that are more than faint, and of lenses that see behind them fewer.

    Raises InsufficientData where the field goes around the baseline all the same: it is an axial pair's.
    """
    if not field.around:
        return extent(field.rows, field.left.about)
    if frame.view_angle >= _OBLIQUE:
        return arc(field.rows, field.left.about).within(Interval(-_BEHIND, _BEHIND))
    for faint in _FAINT:
        rows = arc(field.rows, field.left.about, faint)
        if rows.width <= _ALL_AROUND:
            return rows
    raise frame.axial()


def _region(field: CommonField, rows: Interval, along: int, options: RectifiedViewOptions) -> Region:
    """Return the angles to be shown: those that are useful, or the field of view asked for about their middle."""
    held = rows.holds(field.left.about)[:, None]
    offs = [extent((each.weights * held).sum(axis=0), each.off) for each in (field.left, field.right)]
    if options.fov_deg is None:
        return Region(rows, (offs[0], offs[1]))
    halves = np.radians(options.fov_deg) / 2
    off, about = halves[along], halves[1 - along]
    first, second = (Interval(each.middle - off, each.middle + off) for each in offs)
    return Region(Interval(rows.middle - about, rows.middle + about), (first, second))


def _projection(region: Region) -> str:
    """Return the simplest projection that holds a region without stretching it much."""
    off = max(abs(edge) for each in region.off for edge in each)
    if max(off, *map(abs, region.about)) <= _WIDEST[PINHOLE]:
        return PINHOLE
    return CYLINDRICAL if off <= _WIDEST[CYLINDRICAL] else LATLON


class ImagePair(NamedTuple):
    """Two images, the left (or upper) one first, in the type of their sources."""

    left: PixelArray
    right: PixelArray


@dataclass(frozen=True, eq=False)
class PairMaps(Brief):
    """Where every pixel of the rectified images of the left and of the right camera comes from."""

    left: Maps
    right: Maps

    def apply(self, left: Array, right: Array) -> ImagePair:
        """Return the rectified images of those of the left and of the right camera, black where they saw nothing.

        Raises InvalidInput for images of another size than the camera's.
        """
        return ImagePair(self.left.apply(left), self.right.apply(right))

    @property
    def valid(self) -> tuple[BoolArray, BoolArray]:
        """The masks (H, W) of the pixels that have a source."""
        return self.left.valid(), self.right.valid()

    def arrays(self, names: tuple[str, str] = ("left", "right")) -> dict[str, Float32Array]:
        """Return the maps (H, W) as cv2.remap takes them: NAME_map1 with columns, NAME_map2 with rows of the source."""
        return {
            f"{name}_map{number}": values
            for name, maps in zip(names, (self.left, self.right), strict=True)
            for number, values in ((1, maps.x), (2, maps.y))
        }


def build_pair_maps(
    cameras: Mapping[str, Camera],
    rectification: Rectification,
    interpolation: str = "linear",
    circles: Mapping[str, ImageCircle | None] | None = None,
) -> PairMaps:
    """Return the maps for a rectification of two cameras by their names; circles: as in `plan_rectification`.

    Raises InvalidInput for an unknown interpolation.
    """
    found = rectification
    known = circles or {}
    left, right = (
        build_maps(cameras[name], view, interpolation, turn.T, known.get(name))
        for name, view, turn in (
            (found.left, found.left_camera, found.rect_R_left),
            (found.right, found.right_camera, found.rect_R_right),
        )
    )
    return PairMaps(left, right)
