"""What one image shows of a board."""

from dataclasses import dataclass

import numpy as np

from camcal.arrays import Array, readonly
from camcal.targets.board import Board, Detection

MIN_CORNERS = 4  # as many as a homography needs


@dataclass(frozen=True, eq=False)
class Sighting:
    """Points ids (N,) at pixels (N, 2) with their covariance (N, 2, 2) px² where it is known, or none and the reason.

    other: the board in sight that is not the one that was looked for.
    """

    ids: Array
    pixels: Array
    reason: str | None = None
    other: Board | None = None
    covariance: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", readonly(self.ids, (None,), "ids", np.intp))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.ids), 2), "pixels"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.ids), 2, 2), "covariance"))

    @classmethod
    def nothing(cls, reason: str, other: Board | None = None) -> "Sighting":
        """Return the record of an image without points to use."""
        return cls(np.zeros(0, np.intp), np.zeros((0, 2)), reason, other)

    @classmethod
    def of(cls, grid: Array, covariance: Array | None = None) -> "Sighting":
        """Return the points of a grid (rows, columns, 2), NaN where none; none if too few for a pose.

        covariance: (rows, columns, 2, 2) px² of the grid's points.
        """
        found = ~np.isnan(grid[..., 0])
        count = int(found.sum())
        if count < MIN_CORNERS:
            return cls.nothing(f"only {count} corner{'s' if count != 1 else ''}" if count else "no corner found")
        if min(found.any(axis=0).sum(), found.any(axis=1).sum()) < 2:
            return cls.nothing(f"only {count} corners, all in one line")
        return cls(np.flatnonzero(found), grid[found], covariance=None if covariance is None else covariance[found])

    @property
    def found(self) -> bool:
        """Whether there are corners."""
        return len(self.ids) > 0

    def in_image(self, image: str, size: tuple[int, int], orientation: int = 1) -> Detection:
        """Return the record of what was seen in an image of a name, size (width, height) and EXIF orientation."""
        return Detection(
            image, size, self.ids, self.pixels, self.covariance, reason=self.reason, orientation=orientation
        )
