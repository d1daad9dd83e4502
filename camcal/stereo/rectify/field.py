"""The field that two cameras have in common, in angles about and off the plane across their baseline.

λ: the angle of a direction off that plane, φ: the angle about the baseline. A point is at one φ for both cameras; the
nearer it is, the more the left camera's λ exceeds the right one's. What one camera sees is useful where the other one
sees the same φ at a λ that a point at some distance may have.
"""

from typing import Any, NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.model import Camera
from camcal.cameras.validity import ImageCircle, pixel_angles, rim
from camcal.dataclass import dataclass

CELLS = 192  # of the grid of directions, along either angle
FAINT = 0.05  # of the fullest row or column: those with less, at the ends, are left out
_PIXELS = 48  # a side, that tell how far the grid reaches
_PER_EDGE = 96
_BESIDE = 1e-6  # px beside the outermost pixel centres, by rounding


class Directions(NamedTuple):
    """Angles of directions, rad: λ off the plane across the baseline, φ about the baseline."""

    off: Array
    about: Array


class Interval(NamedTuple):
    """From where to where: numbers, or arrays (N, 1) of the intervals of rows."""

    low: Any
    high: Any

    @property
    def width(self) -> float:
        return float(self.high - self.low)

    @property
    def middle(self) -> float:
        return float(self.low + self.high) / 2

    def within(self, other: "Interval") -> "Interval":
        """Return the part of it inside another one."""
        return Interval(np.maximum(self.low, other.low), np.minimum(self.high, other.high))

    def holds(self, values: Array) -> Array:
        """Return the mask of values inside."""
        return np.asarray((values >= self.low) & (values <= self.high))


@dataclass(frozen=True, eq=False)
class Viewer:
    """A camera of the pair: its lens, its image circle, and rect_R_camera (3, 3) to the axes of the pair.

    along: which of them, 0 or 1, is the baseline.
    """

    camera: Camera
    circle: ImageCircle | None
    rect_R_camera: Array
    along: int

    def turned(self, rotation: Array) -> "Viewer":
        """Return the same in axes that a rotation (3, 3) takes the present ones to."""
        return Viewer(self.camera, self.circle, rotation @ self.rect_R_camera, self.along)

    def pixels(self, where: Directions) -> Array:
        """Return the pixels (N, 2) that see directions (N,) each; NaN where none does."""
        rays = rays_of(where, self.along) @ self.rect_R_camera
        pixels = self.camera.project(rays).pixels
        last = np.array(self.camera.image_size) - 1
        with np.errstate(invalid="ignore"):
            inside = np.all((pixels >= -_BESIDE) & (pixels <= last + _BESIDE), axis=1)
        if self.circle is not None:
            inside = inside & self.circle.contains(pixels)
        return np.where(inside[:, None], pixels, np.nan)

    def sees(self, off: Array, about: Array) -> Array:
        """Return the mask (R, C) of directions with λ of (C,) and φ of (R,) that are seen."""
        grid = np.meshgrid(off, about)
        pixels = self.pixels(Directions(grid[0].ravel(), grid[1].ravel()))
        return np.asarray(np.isfinite(pixels[:, 0])).reshape(grid[0].shape)

    @property
    def axis(self) -> float:
        """The λ (rad) of the optical axis."""
        return float(directions_of(self.rect_R_camera[None, :, 2], self.along).off[0])

    def outline(self) -> Directions:
        """Return the directions of pixels around all that is seen."""
        return self._seen_at(rim(self.camera, _PER_EDGE, self.circle)[0])

    def samples(self) -> Directions:
        """Return the directions of pixels all over the image, and of its outline."""
        inside, around = self._seen_at(self._all_over()), self.outline()
        return Directions(np.concatenate([inside.off, around.off]), np.concatenate([inside.about, around.about]))

    def spread(self) -> tuple[Directions, Array]:
        """Return the directions (N,) of pixels all over the image, and the solid angle (N,) of each, relative."""
        pixels = self._all_over()
        pixels = pixels[self.camera.unproject(pixels).valid]
        return self._seen_at(pixels), np.nan_to_num(pixel_angles(self.camera, pixels)) ** 2

    def _all_over(self) -> Array:
        width, height = self.camera.image_size
        grid = np.meshgrid(np.linspace(0, width - 1, _PIXELS), np.linspace(0, height - 1, _PIXELS))
        pixels = np.column_stack([axis.ravel() for axis in grid])
        return pixels if self.circle is None else pixels[self.circle.contains(pixels)]

    def _seen_at(self, pixels: Array) -> Directions:
        rays = self.camera.unproject(pixels)
        return directions_of(rays.directions[rays.valid] @ self.rect_R_camera.T, self.along)


def directions_of(rays: Array, along: int) -> Directions:
    """Return the angles (N,) of rays (N, 3) in axes of which `along` is the baseline."""
    length, across, forward = rays[:, along], rays[:, 1 - along], rays[:, 2]
    return Directions(np.arctan2(length, np.hypot(across, forward)), np.arctan2(across, forward))


def rays_of(where: Directions, along: int) -> Array:
    """Return the unit rays (N, 3) of directions (N,)."""
    radius = np.cos(where.off)
    rays = np.empty((len(radius), 3))
    rays[:, along], rays[:, 1 - along] = np.sin(where.off), radius * np.sin(where.about)
    rays[:, 2] = radius * np.cos(where.about)
    return rays


@dataclass(frozen=True, eq=False)
class Useful:
    """What is useful of one camera's field: a mask (R, C) over φ, `about` (R,), and λ, `off` (C,)."""

    off: Array
    about: Array
    mask: Array

    @property
    def weights(self) -> Array:
        """The solid angle (R, C) of every useful cell, zero elsewhere, in units of their own."""
        return np.asarray(self.mask * (np.cos(self.off) * _step(self.off)))

    def cells(self) -> Directions:
        """Return the directions (R, C) of the cells."""
        return Directions(*np.meshgrid(self.off, self.about))


@dataclass(frozen=True, eq=False)
class CommonField:
    """What is useful of both cameras.

    around: whether its φ go all around the baseline. near: baseline by distance of the nearest points.
    """

    left: Useful
    right: Useful
    around: bool
    near: float

    @property
    def rows(self) -> Array:
        """The solid angle (R,) at every φ."""
        return np.asarray((self.left.weights + self.right.weights).sum(axis=1))

    @property
    def is_empty(self) -> bool:
        return not self.rows.any()


def common_field(left: Viewer, right: Viewer) -> CommonField:
    """Return the common field on a grid as fine as it needs."""
    seen = left.samples(), right.samples()
    low, high = max(each.about.min() for each in seen), min(each.about.max() for each in seen)
    low, high = (low, high) if low < high else (-np.pi, np.pi)  # one is beyond the seam
    around = high - low > 2 * np.pi * (1 - 4 / CELLS)
    about = _centres(-np.pi, np.pi) if around else _centres(low, high)
    near = _nearest(left.axis, right.axis)
    ends = [Interval(each.off.min(), each.off.max()) for each in seen]
    offs = [_centres(part.low, part.high) for part in _reached(ends[0], ends[1], near)]
    masks = [viewer.sees(off, about) for viewer, off in zip((left, right), offs, strict=True)]
    reached = _reached(_ends(offs[0], masks[0]), _ends(offs[1], masks[1]), near)
    useful = [mask & part.holds(off) for off, mask, part in zip(offs, masks, reached, strict=True)]
    both = np.any(useful[0], axis=1, keepdims=True) & np.any(useful[1], axis=1, keepdims=True)
    first, second = (Useful(off, about, mask & both) for off, mask in zip(offs, useful, strict=True))
    return CommonField(first, second, around, near)


def _ends(off: Array, mask: Array) -> Interval:
    """Return the range of λ (R, 1) seen in every row of a mask (R, C), to the outer edges of cells; NaN without any."""
    half = abs(_step(off)) / 2
    low, high = np.where(mask, off, np.inf).min(axis=1), np.where(mask, off, -np.inf).max(axis=1)
    low, high = (np.where(np.isfinite(each), each, np.nan)[:, None] for each in (low, high))
    return Interval(low - half, high + half)


def _nearest(left_off: float, right_off: float) -> float:
    """Return baseline by distance of the nearest points: at three baselines, or at 2/3 of where the axes meet.

    Distances are from the baseline, so that three baselines along an oblique axis are fewer.
    """
    farthest = np.radians(80)
    left, right = np.clip((left_off, right_off), -farthest, farthest)
    return max(float(1 / (3 * np.cos((left + right) / 2))), float(1.5 * (np.tan(left) - np.tan(right))))


def _reached(left: Interval, right: Interval, near: float) -> tuple[Interval, Interval]:
    """Return the parts of two ranges of λ that see common points: 0 ≤ tan λ_left - tan λ_right ≤ near."""
    return (
        left.within(Interval(right.low, np.arctan(np.tan(right.high) + near))),
        right.within(Interval(np.arctan(np.tan(left.low) - near), left.high)),
    )


def _centres(low: float, high: float) -> Array:
    """Return the centres (CELLS,) of cells from low to high."""
    return np.asarray(low + (np.arange(CELLS) + 0.5) * (high - low) / CELLS)


def _step(centres: Array) -> float:
    return float(centres[1] - centres[0])


def extent(weights: Array, centres: Array, faint: float = FAINT) -> Interval:
    """Return from where to where the weights (N,) of cells are more than faint, to the outer edges of the cells."""
    kept = centres[weights > faint * weights.max()]
    half = _step(centres) / 2
    return Interval(float(kept[0]) - half, float(kept[-1]) + half)


def arc(weights: Array, centres: Array, faint: float = FAINT) -> Interval:
    """Return the same on a full circle, whose cells begin at -π: the complement of the longest faint run.

    Its upper end may exceed π.
    """
    kept = np.flatnonzero(weights > faint * weights.max())
    gaps = np.diff(np.append(kept, kept[0] + len(weights)))
    after = int(np.argmax(gaps))  # the longest gap follows this one
    start, stop = kept[(after + 1) % len(kept)], kept[after]
    half, turn = _step(centres) / 2, 2 * np.pi if stop < start else 0.0
    return Interval(float(centres[start]) - half, float(centres[stop]) + half + turn)
