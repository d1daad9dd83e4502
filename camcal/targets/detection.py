"""What was detected of a board in one image: the record that goes from the detector to the solver.

An image's samples, by which corners are measured, go to the detector as a record too.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from camcal.arrays import Array, readonly
from camcal.cameras.validity import ImageCircle
from camcal.targets.board import Board

MIN_CORNERS = 4  # as many as a homography needs


@dataclass(frozen=True, eq=False)
class Detection:
    """Points ids (N,) at pixels (N, 2) with their covariance (N, 2, 2) px² where it is known, or none and the reason.

    image: the name of the file, or of a frame of a video. size: (width, height). camera, body: the names of the one
    that took the image and of what is seen in it, where there are several. time: s, None where nobody knows.
    orientation: the EXIF tag 1…8 (never applied). sha256: of the file, where it was read.
    other: the board in sight that is not the one that was looked for. colours: the same points by the samples of one
    colour alone, by its name. blur_px: of the board's edges; motion_px: of the board since the frame before; NaN where
    they were not measured.
    """

    image: str = ""
    size: tuple[int, int] = (0, 0)
    ids: Array = field(default_factory=lambda: np.zeros(0, np.intp))
    pixels: Array = field(default_factory=lambda: np.zeros((0, 2)))
    covariance: Array | None = None
    camera: str = ""
    reason: str | None = None
    orientation: int = 1
    body: str = ""
    time: float | None = None
    other: Board | None = None
    colours: "Mapping[str, Detection]" = field(default_factory=dict)
    blur_px: float = float("nan")
    motion_px: float = float("nan")
    sha256: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", readonly(self.ids, (None,), "ids", np.intp))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.ids), 2), "pixels"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.ids), 2, 2), "covariance"))

    @classmethod
    def nothing(cls, reason: str, other: Board | None = None) -> "Detection":
        """Return the record of an image without points to use."""
        return cls(reason=reason, other=other)

    @classmethod
    def of(cls, grid: Array, covariance: Array | None = None) -> "Detection":
        """Return the points of a grid (rows, columns, 2), NaN where none; none if too few for a pose.

        covariance: (rows, columns, 2, 2) px² of the grid's points.
        """
        found = ~np.isnan(grid[..., 0])
        count = int(found.sum())
        if count < MIN_CORNERS:
            return cls.nothing(f"only {count} corner{'s' if count != 1 else ''}" if count else "no corner found")
        if min(found.any(axis=0).sum(), found.any(axis=1).sum()) < 2:
            return cls.nothing(f"only {count} corners, all in one line")
        known = None if covariance is None else covariance[found]
        return cls(ids=np.flatnonzero(found), pixels=grid[found], covariance=known)

    @property
    def found(self) -> bool:
        """Whether there are points."""
        return len(self.ids) > 0

    def without_points(self, reason: str) -> "Detection":
        """Return the record of the same image without its points, and why."""
        nothing = Detection()
        return replace(
            self, ids=nothing.ids, pixels=nothing.pixels, covariance=None, colours=nothing.colours, reason=reason
        )

    def renumbered(self, numbers: Array) -> "Detection":
        """Return the points with other ids: numbers (C,) holds the new one of every point of the board."""
        colours = {colour: view.renumbered(numbers) for colour, view in self.colours.items()}
        return replace(self, ids=numbers[self.ids], colours=colours)


@dataclass(frozen=True)
class Detections:
    """What was found in a set of images, in their order, and the board that was looked for (None: unknown).

    circles: the image circles of cameras by their names, as far as they were measured.
    """

    board: Board | None
    views: tuple[Detection, ...]
    circles: Mapping[str, ImageCircle] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Samples:
    """Values (H, W), uint8 or any other kind of number, and the mask (H, W) of those that count, None: all.

    The samples of one colour of a mosaic are such a mask.
    """

    values: Array
    sites: Array | None = None
