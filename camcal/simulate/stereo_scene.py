"""Rendered rectified pairs of a generated scene, with exact disparity.

The left camera stands in the origin of the world, the right one `baseline` to its right; both see along z. A disparity
belongs to the ray through the middle of a pixel; nothing is taken from the pictures.

A picture is what every pixel gathers under a point spread, which is the pixel's own square blurred by a Gaussian. The
image plane is cut into cells, several to a pixel. A cell on one surface has the brightness of its middle, for paint is
smooth; one that an edge goes through is examined in many places. Every cell counts with the share of the spread that
lies on it: that is exact for edges of even surfaces.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import fields
from functools import lru_cache

import numpy as np

from camcal.arrays import Array, readonly
from camcal.cameras.catalogue import model_named
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.simulate.render import REACH, spread
from camcal.simulate.stereo_surfaces import NOTHING, Surface, colours, first_hits
from camcal.simulate.stereo_world import ViewFrustum, make_world

SAME = 1e-6  # by this share may depths differ that are those of one point

_STRIP = 1 << 18  # rays that are worked on at once: their temporaries stay near the processor's cache

GRAY = np.array([0.114, 0.587, 0.299])  # of BGR, ITU-R BT.601
CELLS = 2  # along a pixel
SHARPEST = 0.3  # px of blur; with less the finest paint would alias between cells
FINE = 8  # an edge cell is examined in 64 places, 8 by 8, but shifted: they lie in 64 different columns and rows
_FINE_LENGTH = 1 / (CELLS * FINE)


@dataclass(frozen=True, eq=False)
class StereoCamera:
    """A pinhole that looks along z: its place (3,), metres, size (width, height), focal length and centre in pixels.

    row_shift: by how many pixels its image lies too low; row_tilt: by how much more at the right border than at the
    left one, 0 in between.
    """

    place: Array
    size: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    row_shift: float = 0.0
    row_tilt: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "place", readonly(self.place, (3,), "place"))

    def rays(self, columns: Array, rows: Array) -> tuple[Array, Array]:
        """Return x and y of the directions (x, y, 1) in which pixels look."""
        level = rows - self._lower(columns)
        return (columns - self.centre[0]) / self.focal, (level - self.centre[1]) / self.focal

    def pixels(self, points: Array) -> tuple[Array, Array]:
        """Return the columns and the rows at which points (N, 3), metres, are seen."""
        x, y, z = (points - self.place).T
        columns = self.focal * x / z + self.centre[0]
        return columns, self.focal * y / z + self.centre[1] + self._lower(columns)

    def contains(self, columns: Array, rows: Array) -> Array:
        """Return which places (N,) lie on a pixel of the image."""
        width, height = self.size
        return (columns >= -0.5) & (columns <= width - 0.5) & (rows >= -0.5) & (rows <= height - 0.5)

    def _lower(self, columns: Array) -> Array:
        return np.asarray(self.row_shift + self.row_tilt * (columns / (self.size[0] - 1) - 0.5))


@dataclass(frozen=True)
class PairOptions:
    """Cameras, world, light and errors of a pair.

    size: (width, height). focal: pixels. baseline: metres. doffs: cx of the right camera less cx of the left, pixels.
    disparities: least and greatest that the left image may have, pixels. objects: how many stand in the world.
    blur: standard deviation of the Gaussian in the point spread, pixels. noise: its standard deviation in 1/255 of
    full scale. gain, offset (in 1/255 of full scale), gamma: of the right image, whose brightness b becomes
    gain · b^gamma + offset. row_shift: by how many pixels the right image lies too low; row_tilt: by how much more at
    its right border than at its left one. depth: 8 or 16 bits. colour: BGR, else gray.
    """

    size: tuple[int, int] = (640, 480)
    focal: float = 560.0
    baseline: float = 0.1
    doffs: float = 0.0
    disparities: tuple[float, float] = (6.0, 64.0)
    objects: int = 14
    blur: float = 0.4
    noise: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    gamma: float = 1.0
    row_shift: float = 0.0
    row_tilt: float = 0.0
    depth: int = 8
    colour: bool = True

    def __post_init__(self) -> None:
        if not all(np.isfinite(getattr(self, each.name)).all() for each in fields(self)):
            raise InvalidInput("the numbers of a pair must be finite")
        if min(self.size) < 16 or max(self.size) > 32000:
            raise InvalidInput(f"images of {self.size[0]} × {self.size[1]} are not simulated; use 16 to 32000 a side")
        if self.focal <= 0 or self.baseline <= 0 or self.gain <= 0 or self.gamma <= 0:
            raise InvalidInput("focal length, baseline, gain and gamma must be positive")
        if self.noise < 0 or self.objects < 0 or not SHARPEST <= self.blur <= 5:
            raise InvalidInput(f"noise and objects are 0 or more, blur is {SHARPEST} to 5 px")
        if self.depth not in (8, 16):
            raise InvalidInput(f"depth of {self.depth} bits: use 8 or 16")
        least, greatest = self.disparities
        if not 0 < least + self.doffs < greatest + self.doffs:
            raise InvalidInput(
                f"disparities of {least:g} to {greatest:g}: the least plus doffs must be above 0 and below the greatest"
            )
        if greatest - least >= self.size[0] or greatest + self.doffs >= 2 * self.focal:
            raise InvalidInput(f"disparities up to {greatest:g} px do not fit images {self.size[0]} px wide")

    @property
    def depths(self) -> tuple[float, float]:
        """The nearest and the farthest depth, metres."""
        least, greatest = self.disparities
        reach = self.focal * self.baseline
        return reach / (greatest + self.doffs), reach / (least + self.doffs)

    def cameras(self) -> tuple[Camera, Camera, Pose]:
        """Return the left camera, the right camera and right_T_left."""
        model = model_named("pinhole")
        middle = (np.array(self.size) - 1) / 2
        left, right = (
            Camera(model, self.size, np.array([self.focal, self.focal, middle[0] + shift, middle[1]]))
            for shift in (0.0, self.doffs)
        )
        return left, right, Pose(np.eye(3), np.array([-self.baseline, 0.0, 0.0]))


@dataclass(frozen=True, eq=False)
class Scene:
    """A world and how it is photographed."""

    surfaces: tuple[Surface, ...]
    options: PairOptions


@dataclass(frozen=True, eq=False)
class StereoTruth:
    """A pair of images and what is true of it.

    left, right: (H, W) or (H, W, 3) BGR, uint8 or uint16. disparity_left, disparity_right: (H, W) float32 pixels at
    the middle of every pixel, column in the left less column in the right image, NaN where nothing is seen.
    visible: (H, W) bool, whether the point that a left pixel shows is in the right image and nothing hides it there.
    left_camera, right_camera: the pinholes that took them, had the right image no vertical error.
    """

    left: Array
    right: Array
    disparity_left: Array
    disparity_right: Array
    visible: Array
    left_camera: Camera
    right_camera: Camera
    right_T_left: Pose

    def __post_init__(self) -> None:
        height, width = self.left.shape[:2]
        for name, dtype in (("disparity_left", np.float32), ("disparity_right", np.float32), ("visible", np.bool_)):
            object.__setattr__(self, name, readonly(getattr(self, name), (height, width), name, dtype))
        for name in ("left", "right"):
            image = getattr(self, name)
            object.__setattr__(self, name, readonly(image, (height, width, *image.shape[2:]), name, image.dtype))


def make_scene(options: PairOptions, rng: np.random.Generator) -> Scene:
    """Return a scene drawn for these cameras and disparities."""
    near, far = options.depths
    middle = (options.size[0] - 1) / 2, (options.size[1] - 1) / 2
    frustum = ViewFrustum(options.size, options.focal, middle, near, far, max(options.disparities[1], 0.0))
    return Scene(make_world(frustum, options.objects, rng), options)


def render_pair(scene: Scene | PairOptions, rng: np.random.Generator) -> StereoTruth:
    """Return the photographs of a scene, or of one that is drawn first, and their truth; rng also draws the noise."""
    if isinstance(scene, PairOptions):
        scene = make_scene(scene, rng)
    options = scene.options
    left_camera, right_camera = _stereo_cameras(options)
    left, right = (picture(scene.surfaces, camera, options.blur) for camera in (left_camera, right_camera))
    right = options.gain * right**options.gamma + options.offset / 255
    left_disparity, visible = disparity(scene.surfaces, left_camera, right_camera)
    right_disparity, _ = disparity(scene.surfaces, right_camera, left_camera)
    camera, other, right_T_left = options.cameras()
    return StereoTruth(
        left=_counts(left, options, rng),
        right=_counts(right, options, rng),
        disparity_left=left_disparity,
        disparity_right=right_disparity,
        visible=visible,
        left_camera=camera,
        right_camera=other,
        right_T_left=right_T_left,
    )


def _stereo_cameras(options: PairOptions) -> tuple[StereoCamera, StereoCamera]:
    x, y = (options.size[0] - 1) / 2, (options.size[1] - 1) / 2
    left = StereoCamera(np.zeros(3), options.size, options.focal, (x, y))
    place = np.array([options.baseline, 0.0, 0.0])
    return left, StereoCamera(
        place, options.size, options.focal, (x + options.doffs, y), options.row_shift, options.row_tilt
    )


def _counts(brightness: Array, options: PairOptions, rng: np.random.Generator) -> Array:
    """Return the image of a brightness (H, W, 3), 0 … 1, with noise, as whole numbers."""
    full = 2**options.depth - 1
    if not options.colour:
        brightness = brightness @ GRAY
    noise = rng.standard_normal(brightness.shape, dtype=np.float32) * (options.noise / 255)
    values = np.rint(np.clip(brightness + noise, 0, 1) * full)
    return np.asarray(values, dtype=np.uint8 if options.depth == 8 else np.uint16)


def picture(surfaces: Sequence[Surface], camera: StereoCamera, blur: float) -> Array:
    """Return the picture (H, W, 3), BGR, 0 … 1, that a camera sees; blur: of the Gaussian, pixels."""
    width, height = camera.size
    margin = math.ceil(REACH * blur)  # pixels beside a pixel that its spread reaches into
    weights = _shares(_centres(0, 1, margin), 1 / CELLS, blur)
    columns = _centres(0, width, margin)
    result = np.empty((height, width, 3))
    for first, last in strips(height, CELLS**2 * width):
        rows = _centres(first, last, margin)
        across, down = np.meshgrid(columns, rows)
        surface, points = seen(surfaces, camera, across.ravel(), down.ravel())
        cells = colours(surfaces, surface, points).reshape(*across.shape, 3)
        edge = _edges(surface.reshape(across.shape))
        cells[edge] = 0
        part = _gathered(_gathered(cells, weights, 0), weights, 1)
        _add_edges(part, surfaces, camera, (across, down), edge, blur)
        result[first:last] = part
    return result


def _centres(first: int, last: int, margin: int) -> Array:
    """Return the middles of the cells of pixels first … last - 1 and of a margin around them along one axis."""
    return np.asarray((np.arange(CELLS * (first - margin), CELLS * (last + margin)) + 0.5) / CELLS - 0.5)


def _shares(middles: Array, length: float, blur: float) -> Array:
    """Return the shares of the spread on stretches of a length around their middles, pixels, along one axis."""
    return np.asarray(spread(middles + length / 2, blur) - spread(middles - length / 2, blur))


def _gathered(cells: Array, weights: Array, axis: int) -> Array:
    """Return cells summed up to pixels along an axis; the margin goes."""
    cells = np.moveaxis(cells, axis, 0)
    span = len(cells) - len(weights) + 1
    total = sum(weight * cells[start : start + span : CELLS] for start, weight in enumerate(weights))
    return np.moveaxis(np.asarray(total), 0, axis)


def _edges(surface: Array) -> Array:
    """Return the cells (R, C) that have another surface above, below, to the left or to the right of them."""
    found = np.zeros(surface.shape, bool)
    across, down = surface[:, 1:] != surface[:, :-1], surface[1:] != surface[:-1]
    found[:, 1:] |= across
    found[:, :-1] |= across
    found[1:] |= down
    found[:-1] |= down
    return found


def _add_edges(
    image: Array, surfaces: Sequence[Surface], camera: StereoCamera, grid: tuple[Array, Array], edge: Array, blur: float
) -> None:
    """Add to an image (H, W, 3) what its pixels gather of the edge cells (R, C); grid: the middles of all cells."""
    x, y = _places()
    margin = math.ceil(REACH * blur)
    frame = np.zeros((image.shape[0] + 4 * margin, image.shape[1] + 4 * margin, 3))
    for row in range(CELLS):
        for column in range(CELLS):
            alike = edge[row::CELLS, column::CELLS]
            if not alike.any():
                continue
            columns, rows = (axis[row::CELLS, column::CELLS][alike][:, None] for axis in grid)
            surface, points = seen(surfaces, camera, (columns + x).ravel(), (rows + y).ravel())
            values = colours(surfaces, surface, points).reshape(-1, len(x), 3)
            weights = _edge_weights(row, column, margin, blur)
            spots = np.einsum("cnb,nrs->crsb", values, weights, optimize=True)
            down, across = (places[:, None] + np.arange(2 * margin + 1) for places in np.nonzero(alike))
            np.add.at(frame, (down[:, :, None], across[:, None, :]), spots)
    image += frame[2 * margin : -2 * margin, 2 * margin : -2 * margin]


def _places() -> tuple[Array, Array]:
    """Return the x and y (64,) of the places in an edge cell, pixels from its middle."""
    column, row = np.divmod(np.arange(FINE**2), FINE)
    turned = (column, row), (row, FINE - 1 - column)  # a lattice that is no lattice of rows, columns or diagonals
    x, y = ((coarse + (fine + 0.5) / FINE) / FINE - 0.5 for coarse, fine in turned)
    return x / CELLS, y / CELLS


@lru_cache(maxsize=16)
def _edge_weights(row: int, column: int, margin: int, blur: float) -> Array:
    """Return with what weights (64, R, R) the places in a cell count for the pixels that it reaches, row by row.

    row, column: which of the cells of its pixel it is. The weights of all places add up to the share of the whole cell.
    """
    pixels = np.arange(-margin, margin + 1)
    down, across = ((cell + 0.5) / CELLS - 0.5 - pixels for cell in (row, column))
    x, y = (place[:, None] for place in _places())
    weights = _product(_shares(down + y, _FINE_LENGTH, blur), _shares(across + x, _FINE_LENGTH, blur))
    whole, total = _product(_shares(down, 1 / CELLS, blur), _shares(across, 1 / CELLS, blur)), weights.sum(axis=0)
    return np.asarray(weights * np.divide(whole, total, out=np.zeros_like(total), where=total > 0))


def _product(rows: Array, columns: Array) -> Array:
    """Return the products (..., R, R) of what counts along rows (..., R) and along columns (..., R)."""
    return np.asarray(rows[..., :, None] * columns[..., None, :])


def disparity(surfaces: Sequence[Surface], camera: StereoCamera, other: StereoCamera) -> tuple[Array, Array]:
    """Return the disparity (H, W), float32 pixels, at the pixels of a camera, and which of them (H, W) the other sees.

    The disparity is the column of the left camera less that of the right one; NaN where nothing is seen.
    """
    width, height = camera.size
    result = np.full((height, width), np.nan, np.float32)
    visible = np.zeros((height, width), bool)
    sign = 1 if camera.place[0] < other.place[0] else -1
    for first, last in strips(height, width):
        rows, columns = (grid.ravel() for grid in np.mgrid[first:last, 0:width].astype(float))
        surface, points = seen(surfaces, camera, columns, rows)
        with np.errstate(invalid="ignore"):
            matches, levels = other.pixels(points)
            result[first:last] = (sign * (columns - matches)).reshape(-1, width)
            found = (surface != NOTHING) & other.contains(matches, levels)
        x, y, z = (points[found] - other.place).T
        nearest = first_hits(surfaces, other.place, x / z, y / z)[1]  # in sight of the other camera
        found[found] = ~(nearest < z * (1 - SAME))
        visible[first:last] = found.reshape(-1, width)
    return result, visible


def seen(surfaces: Sequence[Surface], camera: StereoCamera, columns: Array, rows: Array) -> tuple[Array, Array]:
    """Return which surface a camera sees at pixels (N,), and which point (N, 3) of it, NaN if none."""
    x, y = camera.rays(columns, rows)
    surface, depths = first_hits(surfaces, camera.place, x, y)
    depths[surface == NOTHING] = np.nan
    return surface, camera.place + depths[:, None] * np.stack([x, y, np.ones_like(x)], axis=1)


def strips(height: int, rays_of_a_row: int) -> Iterator[tuple[int, int]]:
    """Yield the first and the last but one row of parts of an image that are worked on at once."""
    rows = max(1, _STRIP // rays_of_a_row)
    for first in range(0, height, rows):
        yield first, min(height, first + rows)
