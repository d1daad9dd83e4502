"""The distortion of a plane: rational radial, tangential, thin prism, tilt and shear terms, with their Jacobians.

With r² = x² + y² and c = (1 + k1 r² + k2 r⁴ + …) / (1 + k4 r² + k5 r⁴ + k6 r⁶):
x_d = c x + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
y_d = c y + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴, then the tilt of the sensor.
Decentring terms are the tangential ones of (c x, c y) and their r², in place of x, y and theirs; late prism terms are
the prism's of that r². A prism of two coefficients has s1 and s3 alone.
Sources: Brown, Close-range camera calibration, 1971; Weng, Cohen & Herniou, PAMI 1992 (thin prism);
Claus & Fitzgibbon, CVPR 2005 (rational); Louhichi et al., 2007 (tilt).
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.tilt import Tilt, transform
from camcal.dataclass import dataclass

Columns = tuple[int, ...]

_ZERO, _ONE = np.zeros(()), np.ones(())


@dataclass(frozen=True)
class Roles:
    """Where the coefficients of each kind stand in a model's list of coefficients; empty where it has none."""

    numerator: Columns = ()
    denominator: Columns = ()
    tangential: Columns = ()
    prism: Columns = ()
    decentring: Columns = ()
    late_prism: Columns = ()
    tilt: Columns = ()
    shear: Columns = ()


class Powers(NamedTuple):
    """x², xy, y² and r² of the undistorted coordinates (n,)."""

    xx: Array
    xy: Array
    yy: Array
    square: Array


class Distorted(NamedTuple):
    """Distorted coordinates (n,) and their derivatives: x_y is that of x_d by the undistorted y.

    square: r² before the distortion, NaN where the point misses the sensor. Derivatives that are the same everywhere
    have no axis.
    """

    x: Array
    y: Array
    x_x: Array
    x_y: Array
    y_x: Array
    y_y: Array
    square: Array

    def determinant(self) -> Array:
        """Return the Jacobian determinant (n,): positive where the distortion keeps orientation."""
        return np.asarray(self.x_x * self.y_y - self.x_y * self.y_x)


class Gradient(NamedTuple):
    """Where derivatives by the C coefficients go: rows (2, C, n), each of x_d and y_d times its focal length.

    Scaled as they are written: the rows are most of what a projection writes, a second pass would be felt.
    """

    rows: Array
    focal: Sequence[float]


class Limit(NamedTuple):
    """The radius of the disc on which a distortion is one-to-one, and what the radial part makes of it."""

    radius: float
    distorted: float

    def holds(self, distorted: Distorted) -> Array:
        """Return the mask (n,) of the points inside the disc."""
        return np.asarray(distorted.square < self.radius * self.radius)


@dataclass(frozen=True)
class Distortion:
    """The coefficients of one camera, in the order of its model, and the part that each of them plays."""

    values: tuple[float, ...]
    roles: Roles

    def apply(self, x: Array, y: Array, gradient: Gradient | None = None) -> Distorted:
        """Return the distorted coordinates of undistorted x, y (n,), and fill the gradient if there is one."""
        powers = _powers(x, y)
        if not self.values:
            return Distorted(x, y, x_x=_ONE, x_y=_ZERO, y_x=_ZERO, y_y=_ONE, square=powers.square)
        result = self._radial(x, y, powers, gradient)
        if self.roles.tangential:
            result = self._tangential(self.roles.tangential, x, y, powers, result, gradient)
        if self.roles.prism:
            result = self._prism(self.roles.prism, x, y, powers, result, gradient)
        if self.roles.decentring:
            result = self._decentring(result, gradient)
        if self.roles.tilt:
            result = self._tilt(result, gradient)
        if self.roles.shear:
            result = self._shear(result, gradient)
        return result

    def tilt(self) -> Tilt | None:
        """Return the tilt of the sensor, None where the model has none."""
        return Tilt(*self._of(self.roles.tilt)) if self.roles.tilt else None

    def radial(self, square: Array) -> tuple[Array, Array]:
        """Return c (n,) and its derivative by r² at `square` (n,)."""
        ratio, slope, _ = self._ratio(square)
        return ratio, slope

    def limit(self, reach: float) -> Limit:
        """Return the largest disc, within `reach`, on which the distortion is known to be one-to-one.

        There its stretch along the radius, d(r c)/dr, and across it, c, both exceed the norm of the Jacobian of the
        tangential and prism terms. So the symmetric part of the whole Jacobian is positive definite, and on a convex
        region such a map is one-to-one. A barrel with tangential terms alone folds just there, towards (-p2, -p1).
        Decentring and late prism terms act after the radial part and likewise need theirs below 1.
        """
        return _known_limit(self, reach)

    def find_limit(self, reach: float) -> Limit:
        """Return what `limit` does, found again."""
        if not self.values:
            return Limit(reach, reach)
        numerator, denominator = self._in_radius(self.roles.numerator), self._in_radius(self.roles.denominator)
        across = np.convolve(numerator, denominator)
        along = across + np.convolve(_times_degree(numerator), denominator)
        along -= np.convolve(numerator, _times_degree(denominator))
        bound = self._asymmetry(self.roles.tangential, self.roles.prism)
        bound = np.convolve(bound, np.convolve(denominator, denominator))
        pole = first_root(denominator)
        ends = [first_root(_difference(along, bound)), first_root(_difference(across, bound)), pole, reach]
        if self.roles.decentring:
            last = first_root(_difference(_ONE[None], self._asymmetry(self.roles.decentring, self.roles.late_prism)))
            ends.append(first_root(_difference(denominator, np.convolve([0.0, 1.0 / last], numerator))))
        radius = min(ends)
        if radius >= (1 - 1e-6) * pole:  # a double pole is a root of the others too, but for the rounding
            return Limit(radius, math.inf)
        return Limit(radius, float(radius * self.radial(np.array([radius * radius]))[0][0]))

    def _in_radius(self, columns: Columns) -> Array:
        """Return 1 + a r² + b r⁴ + … as ascending coefficients in r."""
        result = np.zeros(2 * len(columns) + 1)
        result[0], result[2::2] = 1.0, self._of(columns)
        return result

    def _asymmetry(self, tangential: Columns, prism: Columns) -> Array:
        """Return the norm of the Jacobian of tangential and prism terms, as ascending coefficients in r.

        It is 6 |p| r and at most 2 |s1, s3| r + 4 |s2, s4| r³.
        """
        half = len(prism) // 2
        second, fourth = (math.hypot(*self._of(prism[power::half])) if power < half else 0.0 for power in (0, 1))
        return np.array([0.0, 6.0 * math.hypot(*self._of(tangential)) + 2.0 * second, 0.0, 4.0 * fourth])

    def _of(self, columns: Columns) -> list[float]:
        return [self.values[column] for column in columns]

    def _ratio(self, square: Array) -> tuple[Array, Array, Array | None]:
        """Return c, its derivative by r² and 1 / denominator (None where the model has no denominator)."""
        ratio, slope = _polynomial(self._of(self.roles.numerator), square)
        if not self.roles.denominator:
            return ratio, slope, None
        denominator, bend = _polynomial(self._of(self.roles.denominator), square)
        inverse = 1.0 / denominator
        ratio *= inverse
        slope -= ratio * bend
        slope *= inverse
        return ratio, slope, inverse

    def _radial(self, x: Array, y: Array, powers: Powers, gradient: Gradient | None) -> Distorted:
        ratio, slope, inverse = self._ratio(powers.square)
        if gradient is not None:
            for axis, focal, coordinate in zip(gradient.rows, gradient.focal, (x, y), strict=True):
                start = coordinate * focal
                if inverse is not None:
                    start *= inverse
                _fill(axis, self.roles.numerator, start, powers.square)
                if inverse is not None:
                    _fill(axis, self.roles.denominator, -ratio * start, powers.square)
        slope *= 2.0
        x_x, x_y, y_y = slope * powers.xx, slope * powers.xy, slope * powers.yy
        x_x += ratio
        y_y += ratio
        return Distorted(x * ratio, y * ratio, x_x=x_x, x_y=x_y, y_x=x_y, y_y=y_y, square=powers.square)

    def _tangential(
        self, columns: Columns, x: Array, y: Array, powers: Powers, base: Distorted, gradient: Gradient | None
    ) -> Distorted:
        """Return `base`, changed in place, with the tangential terms: x (2 p1 y + 2 p2 x) + p2 r² and its like in y."""
        p1, p2 = self._of(columns)
        if gradient is not None:
            for axis, focal, own, first, second in zip(
                gradient.rows, gradient.focal, (powers.xx, powers.yy), columns, columns[::-1], strict=True
            ):
                np.multiply(powers.xy, 2.0 * focal, out=axis[first])
                np.multiply(own + own + powers.square, focal, out=axis[second])
        common = (2.0 * p1) * y + (2.0 * p2) * x
        for value, along, other in ((base.x, x, p2), (base.y, y, p1)):
            _add(value, along * common, other * powers.square)
        for slope, along, other in ((base.x_x, x, p2), (base.y_y, y, p1)):
            _add(slope, common, (4.0 * other) * along)
        _add(base.x_y, (2.0 * p1) * x, (2.0 * p2) * y)  # y_x is the same array
        return base

    def _prism(
        self, prism: Columns, x: Array, y: Array, powers: Powers, base: Distorted, gradient: Gradient | None
    ) -> Distorted:
        """Return `base`, changed in place, with the thin prism terms."""
        fourth = powers.square * powers.square
        if gradient is not None:
            gradient.rows[:, prism] = 0.0
        slopes = []
        for axis, value in enumerate((base.x, base.y)):
            columns = prism[: len(prism) // 2] if axis == 0 else prism[len(prism) // 2 :]
            first, second = (*self._of(columns), 0.0)[:2]
            _add(value, first * powers.square, second * fourth)
            slopes.append(2.0 * first + (4.0 * second) * powers.square)
            if gradient is not None:
                for column, power in zip(columns, (powers.square, fourth), strict=False):
                    np.multiply(power, gradient.focal[axis], out=gradient.rows[axis, column])
        return base._replace(
            x_x=base.x_x + slopes[0] * x,
            x_y=base.x_y + slopes[0] * y,
            y_x=base.y_x + slopes[1] * x,
            y_y=base.y_y + slopes[1] * y,
        )

    def _decentring(self, base: Distorted, gradient: Gradient | None) -> Distorted:
        """Return `base` with tangential and prism terms of its distorted coordinates."""
        x, y, columns = base.x, base.y, self.roles.decentring
        cross = np.zeros_like(x)
        same = Distorted(
            x.copy(), y.copy(), x_x=np.ones_like(x), x_y=cross, y_x=cross, y_y=np.ones_like(x), square=base.square
        )
        powers = _powers(x, y)
        moved = self._tangential(columns, x, y, powers, same, gradient)
        if self.roles.late_prism:
            moved = self._prism(self.roles.late_prism, x, y, powers, moved, gradient)
        return _chained(moved, base, gradient, min(columns))

    def _shear(self, base: Distorted, gradient: Gradient | None) -> Distorted:
        """Return `base` with (x, y) moved by (e y, d x), e and d the two coefficients; it is the only distortion."""
        columns = self.roles.shear
        across, down = self._of(columns)
        if gradient is not None:
            gradient.rows[:] = 0.0
            for axis, value in enumerate((base.y, base.x)):
                np.multiply(value, gradient.focal[axis], out=gradient.rows[axis, columns[axis]])
        x, y = base.x + across * base.y, base.y + down * base.x
        return base._replace(x=x, y=y, x_x=_ONE, x_y=np.array(across), y_x=np.array(down), y_y=_ONE)

    def _tilt(self, base: Distorted, gradient: Gradient | None) -> Distorted:
        tilt = Tilt(*self._of(self.roles.tilt))
        matrix = tilt.homography()
        x, y, scale = transform(matrix, base.x, base.y)
        inverse = 1.0 / scale
        x, y = x * inverse, y * inverse
        # d(x_t, y_t)/d(x_d, y_d), by the quotient rule
        a, b = ((matrix[0, column] - x * matrix[2, column]) * inverse for column in (0, 1))
        c, d = ((matrix[1, column] - y * matrix[2, column]) * inverse for column in (0, 1))
        if gradient is not None:
            for column, derivative in zip(self.roles.tilt, tilt.homography_derivatives(), strict=True):
                by_x, by_y, by_scale = transform(derivative, base.x, base.y)
                for axis, focal, by, value in zip(gradient.rows, gradient.focal, (by_x, by_y), (x, y), strict=True):
                    np.multiply(by - value * by_scale, focal * inverse, out=axis[column])
        square = np.where(scale > 0, base.square, np.nan)  # else the ray meets the sensor's plane behind the lens
        return _chained(Distorted(x, y, x_x=a, x_y=b, y_x=c, y_y=d, square=square), base, gradient, self.roles.tilt[0])


@lru_cache(maxsize=256)
def _known_limit(distortion: Distortion, reach: float) -> Limit:
    """Return the limit of a distortion; every projection by one camera asks for it again."""
    return distortion.find_limit(reach)


def first_root(coefficients: Array) -> float:
    """Return the smallest positive root of 1 + a₁t + a₂t² + …, given as (1, a₁, a₂, …); inf if there is none.

    0 if a coefficient is not finite: such a function holds nowhere.
    """
    if not np.isfinite(coefficients).all():
        return 0.0
    # In 1/t the polynomial is monic, so that a tiny last coefficient does no harm.
    inverse = np.roots(coefficients)
    # A double root comes out as a pair split by the square root of the rounding.
    real = inverse.real[np.abs(inverse.imag) <= 1e-7 * np.abs(inverse)]
    largest = float(real.max(initial=0.0))
    # Nearer to zero is the noise of roots at infinity; a radius of 1e6 is 1e-6 rad from 90° on a pinhole's plane.
    return 1.0 / largest if largest > 1e-6 else math.inf


def _chained(last: Distorted, base: Distorted, gradient: Gradient | None, before: int) -> Distorted:
    """Return the distortion `last` of the coordinates in `base` with its derivatives by the undistorted ones.

    Its own coefficients follow the first `before` ones, whose rows of the gradient are brought through it.
    """
    a, b, c, d = last.x_x, last.x_y, last.y_x, last.y_y
    if gradient is not None:
        rows, ratio = gradient.rows, gradient.focal[0] / gradient.focal[1]
        across, down = b * ratio, c / ratio
        for column in range(before):
            first, second = rows[0, column], rows[1, column]
            rows[0, column], rows[1, column] = a * first + across * second, down * first + d * second
    return last._replace(
        x_x=a * base.x_x + b * base.y_x,
        x_y=a * base.x_y + b * base.y_y,
        y_x=c * base.x_x + d * base.y_x,
        y_y=c * base.x_y + d * base.y_y,
    )


def _times_degree(coefficients: Array) -> Array:
    """Return r times the derivative by r, as ascending coefficients."""
    return np.asarray(coefficients * np.arange(len(coefficients)))


def _difference(first: Array, second: Array) -> Array:
    length = max(len(first), len(second))
    result = np.pad(first, (0, length - len(first)))
    result[: len(second)] -= second
    return result


def _powers(x: Array, y: Array) -> Powers:
    xx, yy = x * x, y * y
    return Powers(xx, x * y, yy, xx + yy)


def _polynomial(coefficients: Sequence[float], variable: Array) -> tuple[Array, Array]:
    """Return 1 + a₁t + a₂t² + … and its derivative at t = `variable` (n,), by Horner's rule."""
    if not coefficients:
        return np.ones_like(variable), np.zeros_like(variable)
    last, following, *rest = (*coefficients[::-1], 1.0)
    value, slope = last * variable, np.full_like(variable, last)
    value += following
    for coefficient in rest:
        slope *= variable
        slope += value
        value *= variable
        value += coefficient
    return value, slope


def _add(total: Array, *parts: Array) -> None:
    """Add the parts to `total` in place, which spares the memory traffic of new arrays."""
    for part in parts:
        total += part


def _fill(rows: Array, columns: Columns, start: Array, square: Array) -> None:
    """Write start · r², start · r⁴, … into the rows of `columns`."""
    for column in columns:
        start = np.multiply(start, square, out=rows[column])
