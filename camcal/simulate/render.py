"""Rendered images of a board: pattern, surface, lens, illumination, sensor noise.

Regions of constant brightness are integrated over every pixel, from nothing but their outlines.
A pixel is the drawing under a point spread: its own square, one pixel wide, blurred by a Gaussian. By Green's theorem
the integral of a region under any spread p(u) q(v) is one along its outline, ∮ P(u) q(v) dv with P' = p. The difference
of neighbouring pixels of a row is local to the outline, so outlines are added up as steps, and a running sum along
the rows gives the image. Nothing is supersampled; curved and slanted edges and their corners need no special care, and
the work grows with the length of the edges, not with the area.

The true shape of a board has formulas of its own, bow, twist, cubic and stretch, written apart from the basis that
calibration estimates (targets/board.py), so that a mistake in one does not hide in the other. x and y run over
[-1, 1] on the points, as drawn; the border follows the formulas.
"""

import math
from dataclasses import astuple
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from camcal.arrays import Array, readonly
from camcal.cameras.model import Camera
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.geometry.pose import Pose
from camcal.targets.board import Board
from camcal.targets.pattern import Pattern, pattern_of

SIDES = 256  # of the polygon that stands for a circle; at a radius of 50 px it is within 0.003 px of it
REACH = 4.0  # standard deviations of blur after which the spread ends; 6e-5 of it is further out
FINENESS = 1 << 14  # entries of the spread's table per pixel: edges are placed to 3e-5 px
PART = 500_000  # pixels that are worked on at once: their temporaries stay near the processor's cache


@dataclass(frozen=True)
class Shape:
    """How a board differs from its drawing; amplitudes in the board's unit (m, or squares when its size is unknown).

    z = bow_x (1 - x²) + bow_y (1 - y²) + twist x y + cubic (x³ - x), in the board's frame; stretch lengthens x by a
    ratio.
    """

    bow_x: float = 0.0
    bow_y: float = 0.0
    twist: float = 0.0
    cubic: float = 0.0
    stretch: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(astuple(self)).all() or abs(self.stretch) >= 1:
            raise InvalidInput(f"not the shape of a board: {self}; amplitudes are finite, the stretch is below 100 %")

    def __add__(self, other: "Shape") -> "Shape":
        return Shape(
            self.bow_x + other.bow_x,
            self.bow_y + other.bow_y,
            self.twist + other.twist,
            self.cubic + other.cubic,
            self.stretch + other.stretch,
        )

    def apply(self, board: Board, drawn: Array) -> Array:
        """Return where places (..., 2) of the drawing are in the board frame (..., 3), both in the board's unit."""
        half = np.array(board.extent) / 2
        x, y = np.moveaxis((drawn - half) / half, -1, 0)
        height = self.bow_x * (1 - x**2) + self.bow_y * (1 - y**2) + self.twist * x * y + self.cubic * (x**3 - x)
        return np.stack([half[0] + (1 + self.stretch) * half[0] * x, drawn[..., 1], height], axis=-1)

    def points(self, board: Board) -> Array:
        """Return the points (C, 3) of the board as it is, in its unit, in the order of their ids."""
        return self.apply(board, board.points()[:, :2])

    def deflection(self, board: Board) -> float:
        """Return the out-of-plane deflection of the points, peak to peak about their plane, in the board's unit."""
        points = self.points(board)
        plane = np.column_stack([np.ones(len(points)), points[:, :2]])
        return float(np.ptp(points[:, 2] - plane @ np.linalg.lstsq(plane, points[:, 2], rcond=None)[0]))


FLAT = Shape()


def bow(x_m: float, y_m: float) -> Shape:
    """Return a board bent along x and along y by these heights of the middle over the sides."""
    return Shape(bow_x=x_m, bow_y=y_m)


def twist(height_m: float) -> Shape:
    """Return a board whose corners are lifted and lowered in turn by this height."""
    return Shape(twist=height_m)


def cubic(height_m: float) -> Shape:
    """Return a board with an S along x; its largest height is 0.385 of the amplitude x³ - x is multiplied with."""
    return Shape(cubic=height_m)


def stretch(ratio: float) -> Shape:
    """Return a board printed longer along x by this ratio, 0.003 for 0.3 %."""
    return Shape(stretch=ratio)


@dataclass(frozen=True)
class Exposure:
    """Light and sensor. Brightnesses are shares of full scale in the middle of the image, before gamma.

    blur_px: standard deviation of the Gaussian in the point spread, which holds the pixel's own square besides.
    noise_dn: standard deviation of the noise in 1/255 of full scale. gradient: by what share the light changes from
    one side of the image to the other. vignetting: by what share it falls towards the corners. gamma: the image is
    brightness to the power 1 / gamma. depth: 8 or 16 bits a pixel.
    """

    black: float = 0.06
    white: float = 0.78
    background: float = 0.36
    blur_px: float = 0.7
    noise_dn: float = 2.0
    gradient: float = 0.2
    vignetting: float = 0.1
    gamma: float = 1.0
    depth: int = 8

    def __post_init__(self) -> None:
        if not 0 <= self.blur_px <= 5:
            raise InvalidInput(f"blur of {self.blur_px} px: use 0 to 5")
        if not 0 <= self.noise_dn <= 255:
            raise InvalidInput(f"noise of {self.noise_dn}: use 0 to 255 (in 1/255 of full scale)")
        if not 0.1 <= self.gamma <= 10:
            raise InvalidInput(f"gamma of {self.gamma}: use 0.1 to 10")
        if self.depth not in (8, 16):
            raise InvalidInput(f"depth of {self.depth} bits: use 8 or 16")
        shares = (self.black, self.white, self.background, self.gradient, self.vignetting)
        if not all(0 <= share <= 1 for share in shares):
            raise InvalidInput(
                "brightnesses, the gradient and the vignetting of an exposure are shares of 0 to 1 (100 %)"
            )


def render(
    camera: Camera,
    board: Board,
    camera_T_board: Pose,
    *,
    rng: np.random.Generator,
    exposure: Exposure | None = None,
    shape: Shape = FLAT,
) -> Array:
    """Return the photograph (height, width), uint8 or uint16, of a board.

    rng: gives the direction of the light and the noise. The board hides nothing of itself, so bends must be mild, and
    it must be seen from its printed side. Raises InvalidInput if it reaches beyond the lens's field.
    """
    exposure = exposure or Exposure()
    brightness = evenly_lit(camera, board, camera_T_board, exposure, shape)
    return develop(brightness * light(camera.image_size, exposure, rng.uniform(0, 2 * np.pi)), exposure, rng)


def evenly_lit(camera: Camera, board: Board, camera_T_board: Pose, exposure: Exposure, shape: Shape = FLAT) -> Array:
    """Return the brightness (height, width) of a board under even light: what `render` starts from."""
    edges, jumps = outlines(pattern_of(board), exposure)
    ends = _project(camera, camera_T_board, shape.apply(board, edges))
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
    drawn, steps = _walk(edges, board.z_sign * jumps, 1 + (lengths / piece_length(exposure.blur_px)).astype(np.intp))
    path = _project(camera, camera_T_board, shape.apply(board, drawn))
    return exposure.background + draw(camera.image_size, path, steps, exposure.blur_px)


def outlines(pattern: Pattern, exposure: Exposure) -> tuple[Array, Array]:
    """Return the edges (S, 2, 2) of a drawing, start and end as x, y, and the jumps (S,) of brightness across them.

    The jumps are signed as `draw` wants them for a board seen from its printed side whose z points into it.
    """
    edges, jumps = _rectangles(pattern, exposure)
    contrast = (exposure.white - exposure.black) * (pattern.discs[:, 3] - pattern.ink_at(pattern.discs))
    return np.concatenate([edges, rims(pattern.discs)]), np.concatenate([jumps, np.repeat(contrast, SIDES)])


def _rectangles(pattern: Pattern, exposure: Exposure) -> tuple[Array, Array]:
    """Return the edges (S, 2, 2) of a drawing's rectangles and the jumps (S,) across them, see `outlines`."""
    ink = exposure.black + (exposure.white - exposure.black) * pattern.ink
    ink = np.pad(ink, 1, constant_values=exposure.background)
    across, down = -np.diff(ink[1:-1]), np.diff(ink[:, 1:-1], axis=0)
    row, column = np.nonzero(across)
    upright = np.stack([pattern.x[[column, column]], pattern.y[[row, row + 1]]], axis=-1)
    line, place = np.nonzero(down)
    level = np.stack([pattern.x[[place, place + 1]], pattern.y[[line, line]]], axis=-1)
    edges = np.concatenate([upright, level], axis=1).swapaxes(0, 1)
    return edges, np.concatenate([across[row, column], down[line, place]])


def _walk(edges: Array, jumps: Array, counts: Array) -> tuple[Array, Array]:
    """Return a path (N, 2) along edges (S, 2, 2) in `counts` (S,) steps each, and the jump (N - 1,) of every step."""
    edge = np.repeat(np.arange(len(edges)), counts + 1)
    first = np.cumsum(counts + 1) - (counts + 1)
    share = (np.arange(len(edge)) - first[edge]) / counts[edge]
    path = edges[edge, 0] + (edges[edge, 1] - edges[edge, 0]) * share[:, None]
    return path, np.where(edge[1:] == edge[:-1], jumps[edge[1:]], 0.0)


def _project(camera: Camera, camera_T_board: Pose, points: Array) -> Array:
    """Return the pixels (..., 2) of points (..., 3) of the board."""
    projection = camera.project(camera_T_board.apply(points).reshape(-1, 3))
    if not projection.valid.all():
        raise InvalidInput("the board exceeds the field of view of the lens: move it or choose another lens")
    return projection.pixels.reshape(*points.shape[:-1], 2)


def light(size: tuple[int, int], exposure: Exposure, direction: float) -> Array:
    """Return the light (height, width) on each pixel, 1 in the middle; direction (rad): where it is brightest."""
    x, y = (np.arange(length) / (length - 1) - 0.5 for length in size)
    slope = np.cos(direction) * x + np.sin(direction) * y[:, None]
    return np.asarray((1 + exposure.gradient * slope) * (1 - exposure.vignetting * 2 * (x**2 + y[:, None] ** 2)))


def develop(brightness: Array, exposure: Exposure, rng: np.random.Generator) -> Array:
    """Return the image (height, width), uint8 or uint16, of a brightness (height, width) in shares of full scale."""
    full = 2**exposure.depth - 1
    encoded = np.clip(brightness, 0, 1) ** (1 / exposure.gamma)
    noise = rng.standard_normal(brightness.shape, dtype=np.float32) * (exposure.noise_dn / 255)
    values = np.rint(np.clip(encoded + noise, 0, 1) * full)
    return np.asarray(values, dtype=np.uint8 if exposure.depth == 8 else np.uint16)


def rims(discs: Array) -> Array:
    """Return the edges (D · SIDES, 2, 2) of discs (D, 3 or more) x, y, radius: start and end as x, y, from x to y.

    They are polygons of the discs' area, so that what is drawn of them is neither smaller nor larger.
    """
    turn = 2 * math.pi / SIDES
    angles = turn * np.arange(SIDES + 1)
    circle = math.sqrt(turn / math.sin(turn)) * np.column_stack([np.cos(angles), np.sin(angles)])
    corners = discs[:, None, :2] + discs[:, None, 2:3] * circle
    return np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 2)


def piece_length(blur_px: float) -> float:
    """Return how long the steps along an outline may be (px): each counts as if it were all at its middle u.

    The error is of second order, up to 0.4 % of the contrast in the pixels of a corner without blur and 0.1 % with a
    blur of 0.7 px; it is far smaller along edges, where the sum over many steps converges faster than any power.
    """
    return min(max(0.36 * blur_px, 1 / 8), 1 / 2)


def draw(size: tuple[int, int], path: Array, jumps: Array, blur_px: float) -> Array:
    """Return the image (height, width) of regions of constant brightness, zero outside all of them.

    path: (N, 2) pixels, a pen's way along all outlines in steps not longer than `piece_length`. jumps: (N - 1,) the
    brightness at smaller u less the one at larger u where a step runs along +v; zero where the pen is lifted.
    Together the lines must enclose regions, else rows are left with a streak; they may leave the image anywhere.
    """
    reach = math.ceil(0.5 + REACH * blur_px)
    margin = 2 * reach + 3  # so that all that is clipped to the rim stays out of reach of the image
    shape = np.array([size[1], size[0]]) + 2 * margin
    rim = reach + 1
    u = np.clip((path[1:, 0] + path[:-1, 0]) / 2 + margin, rim, shape[1] - 1 - rim)
    v = np.clip(path[:, 1] + margin, rim, shape[0] - 1 - rim)
    kept = (v[:-1] != v[1:]) & (jumps != 0)
    pieces = np.stack([u[kept], v[:-1][kept], v[1:][kept], jumps[kept]])
    steps = np.zeros(shape[0] * shape[1])
    part = max(1, PART // margin**2)
    for first in range(0, pieces.shape[1], part):
        places, values = _steps(pieces[:, first : first + part], blur_px, int(shape[1]))
        np.add.at(steps, places, values)
    image = np.cumsum(steps.reshape(shape), axis=1)
    return np.asarray(image[margin:-margin, margin:-margin])


def _steps(pieces: Array, blur_px: float, width: int) -> tuple[Array, Array]:
    """Return the flat indices of the pixels where pieces (u, v start, v end, jump) change their rows, and how much."""
    u, start, end, jump = pieces[:, :, None]
    reach = 0.5 + REACH * blur_px
    columns = np.floor(u - reach).astype(np.intp) + np.arange(math.ceil(2 * reach) + 2)
    across = np.diff(spread(u - columns, blur_px), axis=1)
    rows = np.floor(np.minimum(start, end) - reach).astype(np.intp) + np.arange(math.ceil(2 * reach) + 2)
    along = (spread(end - rows, blur_px) - spread(start - rows, blur_px)) * jump
    places = rows[:, :, None] * width + columns[:, None, 1:]
    return places.ravel(), (along[:, :, None] * across[:, None, :]).ravel()


def spread(distance: Array, blur_px: float) -> Array:
    """Return the share of the point spread below signed distances (px) from its middle, along one axis."""
    table = _table(blur_px)
    place = (distance * FINENESS + (len(table) // 2 + 0.5)).astype(np.intp)
    return np.asarray(table.take(place, mode="clip"))


@lru_cache(maxsize=4)
def _table(blur_px: float) -> Array:
    """Return the distribution function of the point spread at multiples of 1 / FINENESS px, from 0 to 1."""
    half = math.ceil((0.5 + REACH * blur_px) * FINENESS)
    distance = np.arange(-half, half + 1) / FINENESS
    table = _ramp(distance + 0.5, blur_px) - _ramp(distance - 0.5, blur_px)
    table[0], table[-1] = 0.0, 1.0
    return readonly(table, (2 * half + 1,), "table")


def _ramp(distance: Array, blur_px: float) -> Array:
    """Return max(0, d) blurred by a Gaussian, the second integral of its density."""
    if blur_px == 0:
        return np.maximum(distance, 0.0)
    scaled = distance / blur_px
    return np.asarray(distance * ndtr(scaled) + blur_px / math.sqrt(2 * math.pi) * np.exp(-(scaled**2) / 2))
