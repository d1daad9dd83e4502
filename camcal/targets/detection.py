"""What was detected of a board in one image: the record that goes from the detector to the solver.

An image's samples, by which corners are measured, go to the detector as a record too. Views of one camera may be in
images of several sizes, of which a map makes views in one size. Pixel (0, 0) is the centre of the top-left pixel, so
that x in an image of half the size is (x + 0.5) * 2 - 0.5 in the whole one. An image turned by 90 degrees has lost
which way it was turned; see tasks/calibration/mixed_sizes.py.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from camcal.arrays import Array, FloatArray, IntArray, readonly
from camcal.cameras.validity import ImageCircle
from camcal.dataclass import dataclass, field, replace
from camcal.messages import counted
from camcal.records import Brief
from camcal.targets.board import Board

MIN_CORNERS = 4  # as many as a homography needs


@dataclass(frozen=True, eq=False)
class BoardDetection(Brief):
    """Points ids (N,) at pixels (N, 2) with their covariance (N, 2, 2) px² where it is known, or none and the reason.

    image: the name of the file, or of a frame of a video. size: (width, height). camera, body: the names of the one
    that took the image and of what is seen in it, where there are several. time: s, None where unknown.
    orientation: the EXIF tag 1…8 (never applied). sha256: of the file, where it was read, or of a frame's gray
    levels. other: the board in sight that is not the one that was searched for. colours: the same points by the samples
    of one colour alone, by its name. blur_px: of the board's edges; motion_px: of the board since the frame before; NaN
    where they were not measured. refused: (M, 2) px, points that were found and are not used, of the board or of a
    pattern that is not taken for it; for pictures. inverted: the board is white where it is drawn black. located: its
    points are where a detector puts them, to a tenth of a pixel or two, and yet to be measured.
    """

    image: str = ""
    size: tuple[int, int] = (0, 0)
    ids: IntArray = field(default_factory=lambda: np.zeros(0, np.intp))
    pixels: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    covariance: FloatArray | None = None
    camera: str = ""
    reason: str | None = None
    orientation: int = 1
    body: str = ""
    time: float | None = None
    other: Board | None = None
    colours: "Mapping[str, BoardDetection]" = field(default_factory=dict)
    blur_px: float = float("nan")
    motion_px: float = float("nan")
    sha256: str | None = None
    refused: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    inverted: bool = False
    located: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "ids", readonly(self.ids, (None,), "ids", np.intp))
        object.__setattr__(self, "pixels", readonly(self.pixels, (len(self.ids), 2), "pixels"))
        object.__setattr__(self, "refused", readonly(self.refused, (None, 2), "refused points"))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", readonly(self.covariance, (len(self.ids), 2, 2), "covariance"))

    @classmethod
    def nothing(cls, reason: str, other: Board | None = None, refused: Array | None = None) -> "BoardDetection":
        """Return the record of an image without points to use; refused: (..., 2) px, NaN where there is no point."""
        points = np.zeros((0, 2)) if refused is None else refused.reshape(-1, 2)
        return cls(reason=reason, other=other, refused=points[np.isfinite(points).all(axis=1)])

    @classmethod
    def of(cls, grid: Array, covariance: Array | None = None) -> "BoardDetection":
        """Return the points of a grid (rows, columns, 2), NaN where none; none if too few for a pose.

        covariance: (rows, columns, 2, 2) px² of the grid's points.
        """
        found = ~np.isnan(grid[..., 0])
        count = int(found.sum())
        if count < MIN_CORNERS:
            return cls.nothing(f"only {counted(count, 'corner')}" if count else "no corner found", refused=grid)
        if min(found.any(axis=0).sum(), found.any(axis=1).sum()) < 2:
            return cls.nothing(f"only {count} corners, all collinear", refused=grid)
        known = None if covariance is None else covariance[found]
        return cls(ids=np.flatnonzero(found), pixels=grid[found], covariance=known)

    @property
    def found(self) -> bool:
        """Whether there are points."""
        return len(self.ids) > 0

    def without_points(self, reason: str) -> "BoardDetection":
        """Return the record of the same image without its points, and why."""
        nothing = BoardDetection(reason=reason)
        points = {
            name: getattr(nothing, name) for name in ("ids", "pixels", "covariance", "colours", "reason", "located")
        }
        return replace(self, **points)

    def renumbered(self, numbers: Array) -> "BoardDetection":
        """Return the points with other ids: numbers (C,) holds the new one of every point of the board."""
        colours = {colour: view.renumbered(numbers) for colour, view in self.colours.items()}
        return replace(self, ids=numbers[self.ids], colours=colours)


@dataclass(frozen=True)
class Detections(Brief):
    """What was found in a set of images, in their order, and the board that was searched for (None: unknown).

    circles: the image circles of cameras by their names, as far as they were measured.
    """

    board: Board | None
    views: tuple[BoardDetection, ...]
    circles: Mapping[str, ImageCircle] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.views)

    def __iter__(self) -> Iterator[BoardDetection]:
        """Yield the images in their order."""
        return iter(self.views)

    def __getitem__(self, index: int) -> BoardDetection:
        """Return one image."""
        return self.views[index]


@dataclass(frozen=True, eq=False)
class MaskedImage:
    """Values (H, W), uint8 or any other kind of number, and the mask (H, W) of those that count, None: all.

    The samples of one colour of a mosaic are such a mask.
    """

    values: Array
    sites: Array | None = None


Size = tuple[int, int]

TURNED, HALF, DOUBLE, NEAR = "turned", "half", "double", "near"
CLOCKWISE, COUNTER_CLOCKWISE = 1, 3  # quarter turns, from the image to the others'
NEAR_PX = 2  # a side, by which sizes differ that a driver or a converter has cropped


def size_relation(size: Size, usual: Size) -> str | None:
    """Return how a size (width, height) is related to another one, None if it is the same or has nothing to do with it.

    TURNED: by 90 degrees; HALF, DOUBLE: exactly; NEAR: by NEAR_PX pixels a side at most.
    """
    if size == usual:
        return None
    off = max(abs(one - other) for one, other in zip(size, usual, strict=True))
    if off <= NEAR_PX:
        return NEAR
    if size == usual[::-1]:
        return TURNED
    if (2 * size[0], 2 * size[1]) == usual:
        return HALF
    return DOUBLE if size == (2 * usual[0], 2 * usual[1]) else None


def size_words(size: Size, usual: Size) -> str:
    """Return how a size that is related to another one differs from it, in words; raises KeyError for others."""
    off = " x ".join(str(abs(one - other)) for one, other in zip(size, usual, strict=True))
    return {
        TURNED: "turned by 90 degrees",
        HALF: "half as large",
        DOUBLE: "twice as large",
        NEAR: f"{off} px off",
    }[size_relation(size, usual) or ""]


@dataclass(frozen=True, eq=False)
class PixelMap:
    """How pixels x of one image become those of another of a size (width, height): linear · x + offset."""

    linear: Array
    offset: Array
    size: Size

    def apply(self, view: BoardDetection) -> BoardDetection:
        """Return a view with its points as an image of the other size would show them."""
        covariance = None if view.covariance is None else self.linear @ view.covariance @ self.linear.T
        pixels = view.pixels @ self.linear.T + self.offset
        colours = {colour: self.apply(own) for colour, own in view.colours.items()}
        return replace(view, size=self.size, pixels=pixels, covariance=covariance, colours=colours)


def pixel_map(size: Size, usual: Size, quarter: int = 0) -> PixelMap:
    """Return how pixels of an image of a related size become those of the usual one.

    quarter: CLOCKWISE or COUNTER_CLOCKWISE, for an image that is TURNED. Raises ValueError for unrelated sizes.
    """
    relation = size_relation(size, usual)
    width, height = size
    if relation == TURNED and quarter == CLOCKWISE:
        return PixelMap(np.array([(0.0, -1.0), (1.0, 0.0)]), np.array([height - 1.0, 0.0]), usual)
    if relation == TURNED and quarter == COUNTER_CLOCKWISE:
        return PixelMap(np.array([(0.0, 1.0), (-1.0, 0.0)]), np.array([0.0, width - 1.0]), usual)
    factors = {None: 1.0 if size == usual else None, NEAR: 1.0, HALF: 2.0, DOUBLE: 0.5}
    factor = factors.get(relation)
    if factor is None:
        raise ValueError(f"pixels of {size} do not become those of {usual} with {quarter} quarter turns")
    return PixelMap(factor * np.eye(2), np.full(2, 0.5 * factor - 0.5), usual)
