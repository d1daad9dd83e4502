"""The stereographic plane with a spline correction: any central lens, by its values at a grid of knots.

A point stands u = 2 (X, Y) / (R + Z) from the centre of the plane and is moved by Δu(u), a tensor product of uniform
B-splines; every point depends on the few knots around it. Beyond the outermost knots a lens is not known.
Source: mrcal's LENSMODEL_SPLINED_STEREOGRAPHIC (Kogan), whose parameters these are, in its order.
"""

import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from itertools import product
from typing import ClassVar, NamedTuple

import numpy as np

from camcal.arrays import Array, require_shape
from camcal.cameras.distortion import Distorted, Distortion, Gradient, Limit, Roles
from camcal.cameras.lens import Parameter, ProjectionJacobians, Rays
from camcal.cameras.panoramic import Stereographic
from camcal.cameras.plane_model import CORE, Lens, Slopes, Values, blank, fill_core, parts_of, refine, to_pixels
from camcal.dataclass import dataclass
from camcal.errors import InvalidInput
from camcal.parsing import did_you_mean

CUBIC, QUADRATIC = 3, 2  # degrees of splines
_LARGEST_FOV_DEG = 350.0
_MOST_KNOTS = 100  # a side: a correction finer than a degree over the widest lens
_SAMPLES = np.array([0.0, 0.5, 1.0])  # of a cell, across and down, where it is looked at
_ON_THE_WAY = 64  # places between the centre and a cell
_INSIDE = 0.999  # of the knots: where an inverse may start
EVERYWHERE = Limit(math.inf, math.inf)  # what lies beyond the knots has no r²


@dataclass(frozen=True)
class Knots:
    """A grid of knots (columns, rows) around the centre of the plane; per_unit: knots per unit of the plane."""

    counts: tuple[int, int]
    per_unit: float
    degree: int

    @property
    def half(self) -> tuple[float, float]:
        """How far from the centre the knots reach, across and down."""
        columns, rows = self.counts
        return (columns - 1) / 2 / self.per_unit, (rows - 1) / 2 / self.per_unit

    def places(self) -> Array:
        """Return where the knots stand on the plane (n, 2), row by row."""
        across, down = (np.linspace(-half, half, count) for half, count in zip(self.half, self.counts, strict=True))
        return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)

    def around(self, x: Array, y: Array) -> "Around":
        """Return the knots around places x, y (n,) of the plane; those nearest to them where they are outside."""
        columns, rows = self.counts
        first_x, *across = self._taps(x, columns)
        first_y, *down = self._taps(y, rows)
        return Around(first_y * columns + first_x, *across, *down)

    def _taps(self, place: Array, count: int) -> tuple[Array, list[Array], list[Array]]:
        """Return the first knot (n,) of each place along an axis, weights and their slopes by the place."""
        index = place * self.per_unit
        index += (count - 1) / 2
        at = np.floor(index) if self.degree == CUBIC else np.floor(index + 0.5)
        at -= 1
        first = np.fmin(np.fmax(at, 0.0), float(count - self.degree - 1))  # 0 where the place is no number
        index -= first
        index -= 1
        weights, slopes = (_cubic if self.degree == CUBIC else _quadratic)(index, self.per_unit)
        return first.astype(np.intp), weights, slopes


class Around(NamedTuple):
    """The first knot (n,) around places, the weights of columns and rows of knots from there on, and their slopes."""

    first: Array
    across: list[Array]
    across_slopes: list[Array]
    down: list[Array]
    down_slopes: list[Array]


def _cubic(t: Array, scale: float) -> tuple[list[Array], list[Array]]:
    """Return the weights of four knots at t from the second of them, and their slopes times `scale`."""
    square, other = t * t, 1 - t
    other_square, sixth, half = other * other, 1 / 6, scale / 2
    cube, other_cube = square * t, other_square * other
    weights = [
        sixth * other_cube,
        2 / 3 - square + 0.5 * cube,
        2 / 3 - other_square + 0.5 * other_cube,
        sixth * cube,
    ]
    slopes = [
        -half * other_square,
        scale * (1.5 * square - 2 * t),
        scale * (2 * other - 1.5 * other_square),
        half * square,
    ]
    return weights, slopes


def _quadratic(t: Array, scale: float) -> tuple[list[Array], list[Array]]:
    """Return the weights of three knots at t from the second of them, and their slopes times `scale`."""
    before, after = 0.5 - t, 0.5 + t
    weights = [0.5 * before * before, 0.75 - t * t, 0.5 * after * after]
    return weights, [-scale * before, -2 * scale * t, scale * after]


@dataclass(frozen=True)
class Correction(Distortion):
    """The correction as a distortion of the plane; values: x and y of each knot, row by row."""

    grid: Knots

    def apply(self, x: Array, y: Array, gradient: Gradient | None = None) -> Distorted:
        """Return the corrected coordinates; the rows of a gradient are those of the knots around each point."""
        return self.within(x, y, self.apply_around(x, y, self.grid.around(x, y), gradient))

    def apply_around(self, x: Array, y: Array, near: Around, gradient: Gradient | None = None) -> Distorted:
        """Return what `apply` does, given the knots around x, y (n,), wherever these are."""
        tables, columns = self._tables, self.grid.counts[0]
        taps = len(near.across)
        moved = []
        for table in tables:
            value, along, across = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
            for row, (weight, slope) in enumerate(zip(near.down, near.down_slopes, strict=True)):
                knots = [table[row * columns + tap :].take(near.first, mode="clip") for tap in range(taps)]
                of_row, bend = knots[0] * near.across[0], knots[0] * near.across_slopes[0]
                for knot, own, own_slope in zip(knots[1:], near.across[1:], near.across_slopes[1:], strict=True):
                    of_row += knot * own
                    bend += knot * own_slope
                value += of_row * weight
                bend *= weight
                along += bend
                of_row *= slope
                across += of_row
            moved.append((value, along, across))
        (x_d, x_x, x_y), (y_d, y_x, y_y) = moved
        x_d += x
        y_d += y
        x_x += 1
        y_y += 1
        if gradient is not None:
            _fill(gradient, near)
        return Distorted(x_d, y_d, x_x=x_x, x_y=x_y, y_x=y_x, y_y=y_y, square=x * x + y * y)

    def within(self, x: Array, y: Array, here: Distorted) -> Distorted:
        """Return the coordinates `here` of x, y (n,) with an r² of NaN where the lens is not known."""
        half_x, half_y = self.grid.half
        inside = (np.abs(x) <= half_x) & (np.abs(y) <= half_y)
        if not self.sound.all():
            inside &= np.asarray(self.sound)[self._cell(y, 1), self._cell(x, 0)]
        return here if inside.all() else here._replace(square=np.where(inside, here.square, np.nan))

    def _cell(self, place: Array, axis: int) -> Array:
        count = self.grid.counts[axis]
        index = np.floor(place * self.grid.per_unit + (count - 1) / 2)
        return np.fmin(np.fmax(index, 0.0), count - 2).astype(np.intp)

    @cached_property
    def _tables(self) -> tuple[Array, Array]:
        """The corrections x and y of all knots."""
        values = np.array(self.values)
        return np.ascontiguousarray(values[::2]), np.ascontiguousarray(values[1::2])

    @cached_property
    def sound(self) -> Array:
        """What `find_sound` finds."""
        return _known_sound(self)

    def find_sound(self) -> Array:
        """Return which cells (rows - 1, columns - 1) between knots are one-to-one, and those on the way to them too.

        There the symmetric part of the Jacobian of the correction is positive definite; on a convex region such a map
        is one-to-one.
        """
        columns, rows = self.grid.counts
        places = [
            ((np.arange(count - 1)[:, None] + _SAMPLES).ravel() - (count - 1) / 2) / self.grid.per_unit
            for count in (columns, rows)
        ]
        x, y = (place.ravel() for place in np.meshgrid(*places))
        here = self.apply_around(x, y, self.grid.around(x, y))
        mean = (here.x_y + here.y_x) / 2
        good: Array = (here.x_x > 0) & (here.x_x * here.y_y > mean * mean)
        count = len(_SAMPLES)
        cells = np.array(good.reshape(rows - 1, count, columns - 1, count).all(axis=(1, 3)))
        if cells.all():
            return cells
        ways = np.linspace(0, 1, _ON_THE_WAY)
        centres = [(np.arange(size - 1) + 0.5) - (size - 1) / 2 for size in (columns, rows)]
        across, down = (
            np.clip(np.floor(centre[:, None] * ways + (size - 1) / 2), 0, size - 2).astype(np.intp)
            for centre, size in zip(centres, (columns, rows), strict=True)
        )
        return np.array(cells[down[:, None], across[None]].all(axis=2))

    def find_limit(self, reach: float) -> Limit:
        """Return the distance of the farthest place where the lens is known, and the farthest that it is moved to."""
        del reach
        sound = self.sound
        known = np.zeros(self.grid.counts[::-1], bool)
        for down, across in product((slice(None, -1), slice(1, None)), repeat=2):
            known[down, across] |= sound
        if not known.any():
            return Limit(0.0, 0.0)
        x, y = self.grid.places()[known.ravel()].T
        here = self.apply_around(x, y, self.grid.around(x, y))
        return Limit(float(np.hypot(x, y).max()), float(np.hypot(here.x, here.y).max()))

    def tilt(self) -> None:
        """Return nothing: the spline holds a tilt of the sensor as well."""


@lru_cache(maxsize=32)
def _known_sound(correction: Correction) -> Array:
    """Return where a correction is known; every projection by one camera asks for it again."""
    return correction.find_sound()


def _fill(gradient: Gradient, near: Around) -> None:
    """Write the weights of the knots into the rows (2, 2 · taps, n): those of x, then those of y."""
    taps = len(near.across) * len(near.down)
    gradient.rows[0, taps:] = gradient.rows[1, :taps] = 0.0
    for axis, start in enumerate((0, taps)):
        for place, (down, across) in enumerate(product(near.down, near.across)):
            row = gradient.rows[axis, start + place]
            np.multiply(down, across, out=row)
            row *= gradient.focal[axis]


@dataclass(frozen=True)
class SplinedStereographic(Stereographic):
    """A spline over the stereographic plane.

    knots: columns and rows of them. fov_x_deg: the field of view across over which every point has all its knots around
    it. degree: of the spline, 2 or 3.
    """

    name: str = "splined_stereographic"
    summary: str = "any central lens: a spline over the stereographic plane"
    aliases: tuple[str, ...] = ("splined",)
    knots: tuple[int, int] = (16, 13)
    fov_x_deg: float = 150.0
    degree: int = CUBIC

    is_view: ClassVar[bool] = False

    @cached_property
    def grid(self) -> Knots:
        """The knots on the plane."""
        inner = self.knots[0] - (2 if self.degree == QUADRATIC else 3)
        return Knots(self.knots, inner / (4 * math.tan(math.radians(self.fov_x_deg) / 4)), self.degree)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        columns, rows = self.knots
        names = (f"d{axis}_{row}_{column}" for row in range(rows) for column in range(columns) for axis in "xy")
        return CORE + tuple(Parameter(name, growth=0) for name in names)

    @property
    def configuration(self) -> Mapping[str, object]:
        """What the knots are."""
        degree = {} if self.degree == CUBIC else {"degree": self.degree}
        return {"knots": list(self.knots), "fov_x_deg": self.fov_x_deg, **degree}

    def configured(self, configuration: Mapping[str, object]) -> "SplinedStereographic":
        """Return the model with other knots; raises InvalidInput where they are none."""
        known = {**self.configuration, "degree": self.degree}
        for key in configuration:
            if key not in known:
                raise InvalidInput(f"unknown key {key!r}{did_you_mean(key, list(known))}")
        own = {**known, **configuration}
        knots, fov_x_deg, degree = own["knots"], own["fov_x_deg"], own["degree"]
        if not isinstance(degree, int) or degree not in {QUADRATIC, CUBIC}:
            raise InvalidInput(f"degree {degree!r}: a spline has degree {QUADRATIC} or {CUBIC}")
        counts = list(knots) if isinstance(knots, list | tuple) else []
        if len(counts) != 2 or not all(type(count) is int and degree < count <= _MOST_KNOTS for count in counts):
            raise InvalidInput(f"knots {knots!r}: write [columns, rows] from {degree + 1} to {_MOST_KNOTS}")
        if not isinstance(fov_x_deg, int | float) or not 0 < fov_x_deg <= _LARGEST_FOV_DEG:
            raise InvalidInput(f"fov_x_deg {fov_x_deg!r}: write a number up to {_LARGEST_FOV_DEG:g}")
        found = SplinedStereographic(knots=(counts[0], counts[1]), fov_x_deg=float(fov_x_deg), degree=degree)
        return self if found == self else found

    def correction(self, parameters: Array) -> Correction:
        """Return the correction of a camera with parameters (K,)."""
        values = require_shape(parameters, (len(self.parameters),), "parameters")[len(CORE) :]
        return Correction(tuple(values.tolist()), Roles(), self.grid)

    def project_with_jacobians(
        self, parameters: Array, points: Array, *, within_domain: bool = True
    ) -> ProjectionJacobians:
        """Return the pixels of points (N, 3) with their derivatives, those by the knots around each point."""
        points = require_shape(points, (None, 3), "points")
        (focal, centre, plane, _), spline = self._read(parameters), self.correction(parameters)
        count, taps = len(points), 2 * (self.degree + 1) ** 2
        pixels, valid = np.empty((2, count)), np.empty(count, dtype=bool)
        d_point, d_parameters = np.empty((2, 3, count)), np.empty((2, len(CORE) + taps, count))
        first = np.empty(count, np.intp)
        with np.errstate(all="ignore"):
            for part in parts_of(count):
                flat = self._flatten(points[part], plane)
                rows, near = d_parameters[:, :, part], self.grid.around(flat.x, flat.y)
                distorted = spline.apply_around(flat.x, flat.y, near, Gradient(rows[:, len(CORE) :], focal))
                distorted = spline.within(flat.x, flat.y, distorted)
                first[part] = near.first
                to_pixels(distorted, focal, centre, pixels[:, part])
                fill_core(distorted, rows)
                slopes = Slopes(d_point[:, :, part], rows[:, len(CORE) : len(CORE)])
                self._chain(points[part], flat, distorted, focal, plane, slopes)
                sound = np.isfinite(distorted.square if within_domain else distorted.x + distorted.y)
                blank(flat.front & sound, valid[part], pixels[:, part], d_point[:, :, part], rows)
        return ProjectionJacobians(
            pixels.T, valid, d_point.transpose(2, 0, 1), d_parameters.transpose(2, 0, 1), self._columns(first)
        )

    def _columns(self, first: Array) -> Array:
        """Return the parameters (N, 4 + 2 · taps) that pixels depend on, given the first knots (N,) around points."""
        size, core = self.degree + 1, len(CORE)
        offsets = (self.knots[0] * np.arange(size)[:, None] + np.arange(size)).ravel()
        columns = np.empty((core + 2 * len(offsets), len(first)), np.intp)
        columns[:core] = np.arange(core)[:, None]
        for axis in range(2):
            columns[core + axis * len(offsets) :][: len(offsets)] = core + axis + 2 * (first + offsets[:, None])
        return columns.T

    def unproject(self, parameters: Array, pixels: Array) -> Rays:
        """Return the unit rays (N, 3) of pixels (N, 2)."""
        pixels = require_shape(pixels, (None, 2), "pixels")
        focal, centre, plane, spline = self._read(parameters)
        limits = np.array(self.grid.half)[:, None]
        directions, valid = np.empty((3, len(pixels))), np.empty(len(pixels), dtype=bool)
        with np.errstate(all="ignore"):
            for part in parts_of(len(pixels)):
                target = np.stack([(pixels[part, axis] - centre[axis]) / focal[axis] for axis in (0, 1)])
                place, solved = refine(spline, target, np.clip(target, -_INSIDE * limits, _INSIDE * limits), EVERYWHERE)
                left = ~solved & np.isfinite(target).all(axis=0)
                if left.any():  # the plane is stretched so much that what is near there is far from the solution
                    place[:, left], solved[left] = refine(spline, target[:, left], 0 * target[:, left], EVERYWHERE)
                directions[:, part] = self._lift(place[0], place[1], plane)
                blank(solved, valid[part], directions[:, part])
        return Rays(directions.T, valid)

    def _read(self, parameters: Array) -> Lens:
        """Return the named values of parameters (K,)."""
        core = require_shape(parameters, (len(self.parameters),), "parameters")[: len(CORE)].tolist()
        return Lens(core[:2], core[2:], [], self.correction(parameters))

    def _angle(self, radius: float, plane: Values) -> float:  # noqa: ARG002
        return 2 * math.atan(radius / 2)


MODELS = (SplinedStereographic(),)
