"""Square markers: their detection with OpenCV, with corners refined by their patterns, and the objects they are on.

Tags are the markers of a family and the rigid objects they belong to. Corners of a tag are in the order in which those
of markers are found: clockwise from its top-left as printed.
"""

import re
from collections import Counter
from collections.abc import Mapping

import cv2
import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.dataclass import dataclass, field
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.targets.marker_fit import MarkerFit, fit_marker, looks_alike
from camcal.targets.pattern import FAMILIES, Family, family_named

__all__ = ["FAMILIES", "Markers", "detect_markers"]

_CONTOUR_PX = 0.5  # OpenCV's corners are pixels inside the marker: its edge is so much further out
_LEAST_SIDE_PX = 10  # of a marker that can be read
_APART = 0.05  # of a perimeter: OpenCV's 0.125 takes a marker and its sheet's outline for one, and reads the outline
_AGREEMENT = 0.7  # share of the image's variation that is explained by a marker, not by what looks a little like one
_LARGEST_MOVE = 0.5  # cells; a fit that goes further has found another edge
_UNFITTED_PX = 0.6  # root mean square error of OpenCV's own corners


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers ids (M,), ascending, those of one id from top to bottom, at corners (M, 4, 2) px.

    Corners go clockwise from a marker's top-left as printed.
    As printed: as OpenCV draws the families with names in DICT_, and as the AprilTag project draws tag36h11 and the
    like, which OpenCV draws upside down. covariance: (M, 4, 2, 2) px². warnings: ids left out or not measured.
    """

    ids: IntArray
    corners: FloatArray
    covariance: FloatArray
    warnings: tuple[Message, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.ids)
        object.__setattr__(self, "ids", readonly(self.ids, (None,), "ids", np.intp))
        object.__setattr__(self, "corners", readonly(self.corners, (count, 4, 2), "corners"))
        object.__setattr__(self, "covariance", readonly(self.covariance, (count, 4, 2, 2), "covariance"))


def detect_markers(gray: Array, family: str, *, keep_repeated: bool = False) -> Markers:
    """Return the markers of a family in an image.

    gray: (H, W) uint8. family: one of FAMILIES, or 36h11 and the like. keep_repeated: keep all of an id that is seen
    more than once; otherwise none of them is there, since only one can be real.
    Raises InvalidInput for another kind of image or an unknown family.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise InvalidInput(f"markers are found in gray images of 8 bits, not in {gray.dtype} of shape {gray.shape}")
    drawn_family = family_named(family)
    read = _read(gray, drawn_family) if min(gray.shape) > _LEAST_SIDE_PX else []
    read.sort(key=lambda each: (each[0], *each[1].mean(axis=0)[::-1]))
    repeated = {} if keep_repeated else _count_repeated(gray, read, drawn_family)
    single = [each for each in read if each[0] not in repeated]
    seen = [
        (marker, fit) for marker, start in single if (fit := _locate(gray, start, drawn_family, marker)) is not None
    ]
    counts = Counter(marker for marker, _ in seen)
    once = [(marker, fit) for marker, fit in seen if keep_repeated or counts[marker] == 1]
    corners = np.array([drawn_family.as_printed(fit.corners) for _, fit in once]).reshape(-1, 4, 2)
    covariance = np.array([np.roll(fit.covariance, 2 * drawn_family.turned, axis=0) for _, fit in once]).reshape(
        -1, 4, 2, 2
    )
    repeated |= {} if keep_repeated else {marker: count for marker, count in counts.items() if count > 1}
    warnings = []
    for marker, count in sorted(repeated.items()):
        text = f"id {marker} detected {count} times, none used; --repeated-ids keep uses all"
        warnings.append(Message("repeated_tag_id", text, {"id": marker, "count": count}))
    for marker, fit in once:
        if not fit.settled:
            text = f"id {marker}: corner refinement failed; corners of OpenCV used"
            warnings.append(Message("tag_not_refined", text, {"id": marker}))
    return Markers(np.array([marker for marker, _ in once], np.intp), corners, covariance, tuple(warnings))


def _read(gray: Array, family: Family) -> list[tuple[int, Array]]:
    """Return ids and corners (4, 2) px as OpenCV sees them, clockwise from the top-left of its drawing."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = family.corrected
    parameters.minMarkerDistanceRate = _APART
    parameters.minMarkerPerimeterRate = min(parameters.minMarkerPerimeterRate, 4 * _LEAST_SIDE_PX / max(gray.shape))
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family.dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(np.ascontiguousarray(gray))
    if ids is None:
        return []
    places = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 2)
    return list(zip(map(int, np.asarray(ids).ravel()), places, strict=True))


def _count_repeated(gray: Array, found: list[tuple[int, Array]], family: Family) -> dict[int, int]:
    """Return how often ids are seen, of those that more than one place shows well enough to need no fit."""
    often = {marker for marker, count in Counter(marker for marker, _ in found).items() if count > 1}
    shown = Counter(
        marker
        for marker, start in found
        if marker in often and looks_alike(gray, _outward(start), family.drawing(marker)) > _AGREEMENT
    )
    return {marker: count for marker, count in shown.items() if count > 1}


def _outward(start: Array) -> Array:
    """Return the corners (4, 2) of a marker's edge from those that OpenCV gives."""
    away = start - start.mean(axis=0)
    return np.asarray(start + _CONTOUR_PX * np.sqrt(2) * away / np.linalg.norm(away, axis=1)[:, None])


def _locate(gray: Array, start: Array, family: Family, marker: int) -> MarkerFit | None:
    """Return where a marker is, None for what was taken for one; where the fit fails, OpenCV's corners."""
    drawing = family.drawing(marker)
    outward = _outward(start)
    fit = fit_marker(gray, outward, drawing)
    cell = np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1).max() / len(drawing.ink)
    if fit is not None and fit.settled and np.abs(fit.corners - outward).max() < max(_LARGEST_MOVE * cell, 2.0):
        return fit if fit.agreement > _AGREEMENT else None
    return MarkerFit(outward, np.tile(_UNFITTED_PX**2 * np.eye(2), (4, 1, 1)), 0.0, settled=False)


OPENCV, APRILTAG = "opencv", "apriltag"
TAG_FRAMES = (OPENCV, APRILTAG)

_CORNERS = {
    OPENCV: np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]]),
    APRILTAG: np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]),
}
_SINGLE = re.compile(r"tag_\d+\Z")
_FLATTEST = 1e-3  # the least angle between sides (rad) that a tag can be read at
_BENT = 0.05  # of a side: corners farther out of their plane are no tag's


@dataclass(frozen=True, eq=False)
class TagObjects:
    """What the tags of a family stand for.

    bundles: by name, the corners (4, 3) of every tag on a rigid object in that object's frame (m), by id.
    size: side (m) of tags on no bundle, each an object of its own; None: those without a size of their own are ignored.
    sizes: of single tags that differ, by id. ids: single tags that count, None: all of the family.
    tag_frame: of single tags, see `tag_corners`. The family's name is settled to one of FAMILIES.
    Raises InvalidInput if an id is not of the family or is given twice, or if corners are no tag's.
    """

    family: str
    size: float | None = None
    ids: tuple[int, ...] | None = None
    sizes: Mapping[int, float] = field(default_factory=dict)
    bundles: Mapping[str, Mapping[int, FloatArray]] = field(default_factory=dict)
    tag_frame: str = OPENCV

    def __post_init__(self) -> None:
        family = family_named(self.family)
        object.__setattr__(self, "family", family.name)
        if self.tag_frame not in TAG_FRAMES:
            raise InvalidInput(f"tag frame {self.tag_frame!r} is unknown; use {' or '.join(TAG_FRAMES)}")
        if self.size is None and not self.sizes and not self.bundles:
            raise InvalidInput("tags need a size, such as 53mm, or corners in a bundle")
        if self.ids is not None and self.size is None:
            raise InvalidInput("ids need the size of the tags")
        for size in (*([] if self.size is None else [self.size]), *self.sizes.values()):
            if not (np.isfinite(size) and size > 0):
                raise InvalidInput(f"the side of a tag must be positive, found {size:g}")
        _require_ids(self, family)
        object.__setattr__(
            self,
            "bundles",
            {name: {tag: _tag(tag, corners) for tag, corners in tags.items()} for name, tags in self.bundles.items()},
        )

    def find(self, tag: int) -> tuple[str, FloatArray] | None:
        """Return the name of the object a tag is on and its corners (4, 3) in that object's frame, None if on none."""
        for name, tags in self.bundles.items():
            if tag in tags:
                return name, tags[tag]
        size = self.sizes.get(tag, self.size if self.ids is None or tag in self.ids else None)
        return None if size is None else (single_name(tag), tag_corners(size, self.tag_frame))


def tag_corners(size: float, tag_frame: str = OPENCV) -> Array:
    """Return the corners (4, 3) of a tag of side `size` in its own frame, whose origin is the tag's middle.

    opencv: x right, y up, z out of the tag, towards who looks at it; (-s, s) (s, s) (s, -s) (-s, -s) with s half the
    side, as cv2.SOLVEPNP_IPPE_SQUARE wants them. apriltag: x right, y down, z into the tag, as the AprilTag project has
    it; (-s, -s) (s, -s) (s, s) (-s, s).
    """
    return _CORNERS[tag_frame] * size


def single_name(tag: int) -> str:
    """Return the name of the object that is one tag."""
    return f"tag_{tag}"


def require_id(tag: int, family: Family) -> None:
    """Raise InvalidInput for an id that the family does not have."""
    if not 0 <= tag < family.count:
        raise InvalidInput(f"id {tag} is not in {family.name}, whose ids are 0 to {family.count - 1}")


def require_quadrangle(corners: Array) -> None:
    """Raise InvalidInput unless corners (4, 3) go once around a plane, convex quadrangle."""
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    if not (np.isfinite(corners).all() and lengths.min() > 0):
        raise InvalidInput("two corners are the same" if np.isfinite(corners).all() else "a corner is not finite")
    turns = np.cross(sides, np.roll(sides, -1, axis=0)) / (lengths * np.roll(lengths, -1))[:, None]
    normal = np.cross(corners[2] - corners[0], corners[3] - corners[1])
    length = float(np.linalg.norm(normal))
    if length == 0 or (turns @ normal).min() < _FLATTEST * length:
        raise InvalidInput("the corners are not a convex quadrangle in order: clockwise from top-left")
    if abs((corners[1] - corners[0]) @ normal) / length > _BENT * lengths.max():
        raise InvalidInput("the corners are not in one plane")


def _tag(tag: int, corners: Array) -> Array:
    result = readonly(corners, (4, 3), f"corners of id {tag}")
    try:
        require_quadrangle(result)
    except InvalidInput as error:
        raise InvalidInput(f"id {tag}: {error.message}") from error
    return result


def _require_ids(tags: TagObjects, family: Family) -> None:
    owners: dict[int, str] = {}
    placed = [(single_name(tag), tag) for tag in tags.sizes]
    placed += [(name, tag) for name, bundle in tags.bundles.items() for tag in bundle]
    for name, tag in placed:
        require_id(tag, family)
        if tag in owners:
            raise InvalidInput(f"id {tag} is on {owners[tag]} and on {name}; each tag belongs to one object")
        owners[tag] = name
    for tag in tags.ids or ():
        require_id(tag, family)
    if len(set(tags.ids or ())) < len(tags.ids or ()):
        raise InvalidInput("an id is listed twice")
    for name, bundle in tags.bundles.items():
        if _SINGLE.match(name) or not bundle:
            raise InvalidInput(
                f"bundle {name!r} has no tag" if not bundle else f"{name!r} is the name of a single tag, not a bundle's"
            )
