"""Detection of square markers with OpenCV, with corners refined by their patterns."""

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.errors import InvalidInput
from camcal.messages import Message
from camcal.targets.markers.families import FAMILIES, Family, family_named
from camcal.targets.markers.fit import MarkerFit, fit_marker, looks_alike

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
    known = family_named(family)
    found = _read(gray, known) if min(gray.shape) > _LEAST_SIDE_PX else []
    found.sort(key=lambda each: (each[0], *each[1].mean(axis=0)[::-1]))
    repeated = {} if keep_repeated else _repeated(gray, found, known)
    single = [each for each in found if each[0] not in repeated]
    seen = [(marker, fit) for marker, start in single if (fit := _located(gray, start, known, marker)) is not None]
    counts = Counter(marker for marker, _ in seen)
    once = [(marker, fit) for marker, fit in seen if keep_repeated or counts[marker] == 1]
    corners = np.array([known.as_printed(fit.corners) for _, fit in once]).reshape(-1, 4, 2)
    covariance = np.array([np.roll(fit.covariance, 2 * known.turned, axis=0) for _, fit in once]).reshape(-1, 4, 2, 2)
    repeated |= {} if keep_repeated else {marker: count for marker, count in counts.items() if count > 1}
    warnings = [_repeated_id(marker, count) for marker, count in sorted(repeated.items())]
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


def _repeated(gray: Array, found: list[tuple[int, Array]], family: Family) -> dict[int, int]:
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


def _located(gray: Array, start: Array, family: Family, marker: int) -> MarkerFit | None:
    """Return where a marker is, None for what was taken for one; where the fit fails, OpenCV's corners."""
    drawing = family.drawing(marker)
    outward = _outward(start)
    fit = fit_marker(gray, outward, drawing)
    cell = np.linalg.norm(start - np.roll(start, 1, axis=0), axis=1).max() / len(drawing.ink)
    if fit is not None and fit.settled and np.abs(fit.corners - outward).max() < max(_LARGEST_MOVE * cell, 2.0):
        return fit if fit.agreement > _AGREEMENT else None
    return MarkerFit(outward, np.tile(_UNFITTED_PX**2 * np.eye(2), (4, 1, 1)), 0.0, settled=False)


def _repeated_id(marker: int, count: int) -> Message:
    text = f"id {marker} detected {count} times, none used; --repeated-ids keep uses all"
    return Message("repeated_tag_id", text, {"id": marker, "count": count})
