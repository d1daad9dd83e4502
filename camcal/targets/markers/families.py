"""Families of square markers by the names their users know them by.

tag36h11 and DICT_APRILTAG_36h11 are the same markers drawn two ways: OpenCV draws AprilTags upside down, turned by 180°
to the images of the AprilTag project. Which corner is the top-left follows from the name that is given.
"""

import re
from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array
from camcal.errors import InvalidInput
from camcal.opencv import marker_dictionary
from camcal.parsing import nearest
from camcal.targets.markers.drawing import MarkerDrawing

APRILTAGS = ("tag16h5", "tag25h9", "tag36h10", "tag36h11")
ARUCO = (
    *(f"DICT_{cells}X{cells}_{count}" for cells in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
)
FAMILIES = (*APRILTAGS, *ARUCO, *(f"DICT_APRILTAG_{name.removeprefix('tag')}" for name in APRILTAGS))

_SHORT = re.compile(r"(16h5|25h9|36h10|36h11)", re.IGNORECASE)
# Of the bits a code could correct: OpenCV takes 0.6 for all, with which 3 % of all squares pass for a tag16h5
_CORRECTED = {"16h5": 0.0}
_USUALLY_CORRECTED = 0.6


@dataclass(frozen=True, eq=False)
class Family:
    """A family of markers.

    name: one of FAMILIES. dictionary: OpenCV's name. turned: whether the marker is printed upside down to OpenCV's
    drawing. count: ids run from 0 to count - 1.
    """

    name: str
    dictionary: str
    turned: bool
    count: int

    def require(self, first: int, count: int) -> None:
        """Raise InvalidInput unless the family has `count` markers from the id `first` on."""
        if first + count > self.count:
            raise InvalidInput(
                f"the board needs markers {first} to {first + count - 1}, {self.name} ends at {self.count - 1}"
            )

    @property
    def bits(self) -> int:
        """The number of cells across a marker within its black border."""
        return int(marker_dictionary(self.dictionary).markerSize)

    @property
    def corrected(self) -> float:
        """The share of the bits a code could correct that is corrected."""
        return _CORRECTED.get(self.dictionary.removeprefix("DICT_APRILTAG_"), _USUALLY_CORRECTED)

    def drawing(self, marker: int) -> MarkerDrawing:
        """Return what OpenCV draws of a marker."""
        return MarkerDrawing(self._cells(range(marker, marker + 1), 1)[0])

    def printed(self, markers: range, border: int = 1) -> Array:
        """Return the cells (M, n, n) of markers as they are printed, 1 is white; border: of black, around the bits."""
        cells = self._cells(markers, border)
        return np.rot90(cells, 2, axes=(1, 2)) if self.turned else cells

    def _cells(self, markers: range, border: int) -> Array:
        dictionary, side = marker_dictionary(self.dictionary), self.bits + 2 * border
        drawings = [dictionary.generateImageMarker(marker, side, borderBits=border) for marker in markers]
        return np.array(drawings) / 255.0

    def as_printed(self, corners: Array) -> Array:
        """Return corners (..., 4, k) from the top-left of OpenCV's drawing on, from the top-left as printed on."""
        return np.roll(corners, 2, axis=-2) if self.turned else corners


def family_named(name: str) -> Family:
    """Return a family by its name; 36h11 and the like stand for tag36h11. Raises InvalidInput with the nearest name."""
    known = {family.lower(): family for family in FAMILIES}
    full = known.get(f"tag{name}".lower() if _SHORT.fullmatch(name) else name.lower())
    if full is None:
        near = nearest(name.lower(), known, likeness=0.3)
        advice = f"did you mean {known[near]}?" if near else f"known are {', '.join(FAMILIES)}"
        raise InvalidInput(f"marker family {name!r} is unknown; {advice}")
    turned = full in APRILTAGS
    dictionary = f"DICT_APRILTAG_{full.removeprefix('tag')}" if turned else full
    return Family(full, dictionary, turned, len(marker_dictionary(dictionary).bytesList))
