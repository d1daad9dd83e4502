"""The distortion of a plane: rational radial, tangential, thin prism and tilt terms, with their Jacobians.

With r² = x² + y² and c = (1 + k1 r² + k2 r⁴ + …) / (1 + k4 r² + k5 r⁴ + k6 r⁶):
x_d = c x + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
y_d = c y + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴, then the tilt of the sensor.
Sources: Brown, Close-range camera calibration, 1971; Weng, Cohen & Herniou, PAMI 1992 (thin prism);
Claus & Fitzgibbon, CVPR 2005 (rational); Louhichi et al., 2007 (tilt).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from camcal.arrays import Array
from camcal.cameras.tilt import Tilt, transform

Columns = tuple[int, ...]


@dataclass(frozen=True)
class Roles:
    """Where the coefficients of each kind stand in a model's list of coefficients; empty where it has none."""

    numerator: Columns = ()
    denominator: Columns = ()
    tangential: Columns = ()
    prism: Columns = ()
    tilt: Columns = ()


class Powers(NamedTuple):
    """x², xy, y² and r² of the undistorted coordinates (n,)."""

    xx: Array
    xy: Array
    yy: Array
    square: Array


class Distorted(NamedTuple):
    """Distorted coordinates (n,) and their derivatives: x_y is that of x_d by the undistorted y.

    square: r² before the distortion. Without any coefficient the derivatives are plain numbers.
    """

    x: Array
    y: Array
    x_x: Array | float
    x_y: Array | float
    y_x: Array | float
    y_y: Array | float
    square: Array

    def determinant(self) -> Array | float:
        """Return the Jacobian determinant (n,): positive where the distortion keeps orientation."""
        return self.x_x * self.y_y - self.x_y * self.y_x


class Limit(NamedTuple):
    """The radius up to which the radial part is one-to-one, before and after the distortion."""

    radius: float
    distorted: float


@dataclass(frozen=True)
class Distortion:
    """The coefficients of one camera, in the order of its model, and the part that each of them plays."""

    values: tuple[float, ...]
    roles: Roles

    def apply(self, x: Array, y: Array, rows: Array | None = None) -> Distorted:
        """Return the distorted coordinates of undistorted x, y (n,).

        rows: (2, C, n), filled with the derivatives of the two coordinates by the C coefficients.
        """
        powers = _powers(x, y)
        if not self.values:
            return Distorted(x, y, 1.0, 0.0, 0.0, 1.0, powers.square)
        result = self._radial(x, y, powers, rows)
        if self.roles.tangential:
            result = self._tangential(x, y, powers, result, rows)
        if self.roles.prism:
            result = self._prism(x, y, powers, result, rows)
        if self.roles.tilt:
            result = self._tilt(result, rows)
        return result

    def tilt(self) -> Tilt | None:
        """Return the tilt of the sensor, None where the model has none."""
        return Tilt(*self._of(self.roles.tilt)) if self.roles.tilt else None

    def radial(self, square: Array) -> tuple[Array, Array]:
        """Return c (n,) and its derivative by r² at `square` (n,)."""
        ratio, slope, _ = self._ratio(square)
        return ratio, slope

    def limit(self, reach: float) -> Limit:
        """Return where r c(r²) first stops growing or c has a pole, `reach` if that comes first."""
        numerator = np.array([1.0, *self._of(self.roles.numerator)])
        denominator = np.array([1.0, *self._of(self.roles.denominator)])
        pole = math.sqrt(first_root(denominator))
        radius = min(math.sqrt(first_root(_growth(numerator, denominator))), pole, reach)
        if radius == pole:
            return Limit(radius, math.inf)
        return Limit(radius, float(radius * self.radial(np.array([radius * radius]))[0][0]))

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

    def _radial(self, x: Array, y: Array, powers: Powers, rows: Array | None) -> Distorted:
        ratio, slope, inverse = self._ratio(powers.square)
        if rows is not None:
            for axis, coordinate in zip(rows, (x, y), strict=True):
                start = coordinate if inverse is None else coordinate * inverse
                _fill(axis, self.roles.numerator, start, powers.square)
                if inverse is not None:
                    _fill(axis, self.roles.denominator, -ratio * start, powers.square)
        slope *= 2.0
        x_x, x_y, y_y = slope * powers.xx, slope * powers.xy, slope * powers.yy
        x_x += ratio
        y_y += ratio
        return Distorted(x * ratio, y * ratio, x_x, x_y, x_y, y_y, powers.square)

    def _tangential(self, x: Array, y: Array, powers: Powers, radial: Distorted, rows: Array | None) -> Distorted:
        p1, p2 = self._of(self.roles.tangential)
        across = 2.0 * powers.xy
        along_x = powers.square + 2.0 * powers.xx
        along_y = powers.square + 2.0 * powers.yy
        if rows is not None:
            first, second = self.roles.tangential
            rows[0, first], rows[1, first] = across, along_y
            rows[0, second], rows[1, second] = along_x, across
        lift, lean = (2.0 * p1) * y, (2.0 * p2) * x
        x_y = radial.x_y + ((2.0 * p1) * x + (2.0 * p2) * y)
        return radial._replace(
            x=radial.x + (p1 * across + p2 * along_x),
            y=radial.y + (p1 * along_y + p2 * across),
            x_x=radial.x_x + (lift + 3.0 * lean),
            x_y=x_y,
            y_x=x_y,
            y_y=radial.y_y + (3.0 * lift + lean),
        )

    def _prism(self, x: Array, y: Array, powers: Powers, base: Distorted, rows: Array | None) -> Distorted:
        s1, s2, s3, s4 = self._of(self.roles.prism)
        square, fourth = powers.square, powers.square * powers.square
        if rows is not None:
            rows[:, self.roles.prism] = 0.0
            for axis, first, second in ((0, *self.roles.prism[:2]), (1, *self.roles.prism[2:])):
                rows[axis, first], rows[axis, second] = square, fourth
        slope_x, slope_y = 2.0 * s1 + (4.0 * s2) * square, 2.0 * s3 + (4.0 * s4) * square
        return base._replace(
            x=base.x + (s1 * square + s2 * fourth),
            y=base.y + (s3 * square + s4 * fourth),
            x_x=base.x_x + slope_x * x,
            x_y=base.x_y + slope_x * y,
            y_x=base.y_x + slope_y * x,
            y_y=base.y_y + slope_y * y,
        )

    def _tilt(self, base: Distorted, rows: Array | None) -> Distorted:
        tilt = Tilt(*self._of(self.roles.tilt))
        matrix = tilt.homography()
        x, y, scale = transform(matrix, base.x, base.y)
        inverse = 1.0 / scale
        x, y = x * inverse, y * inverse
        # d(x_t, y_t)/d(x_d, y_d), by the quotient rule
        a, b = ((matrix[0, column] - x * matrix[2, column]) * inverse for column in (0, 1))
        c, d = ((matrix[1, column] - y * matrix[2, column]) * inverse for column in (0, 1))
        if rows is not None:
            before = rows[:, : self.roles.tilt[0]]  # the tilt comes last in every list of coefficients
            before[0], before[1] = a * before[0] + b * before[1], c * before[0] + d * before[1]
            for column, derivative in zip(self.roles.tilt, tilt.homography_derivatives(), strict=True):
                by_x, by_y, by_scale = transform(derivative, base.x, base.y)
                rows[0, column], rows[1, column] = (by_x - x * by_scale) * inverse, (by_y - y * by_scale) * inverse
        return base._replace(
            x=x,
            y=y,
            x_x=a * base.x_x + b * base.y_x,
            x_y=a * base.x_y + b * base.y_y,
            y_x=c * base.x_x + d * base.y_x,
            y_y=c * base.x_y + d * base.y_y,
        )


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
    # Below this is the noise of roots at infinity; 1e12 in r² is 1e-6 rad from 90° on a pinhole's plane.
    return 1.0 / largest if largest > 1e-12 else math.inf


def _growth(numerator: Array, denominator: Array) -> Array:
    """Return, as ascending coefficients in t = r², the numerator N D + 2t (N' D - N D') of d(r N/D)/dr."""
    rise = np.convolve(_derivative(numerator), denominator)
    fall = np.convolve(numerator, _derivative(denominator))
    result = np.convolve(numerator, denominator)
    for sign, part in ((2.0, rise), (-2.0, fall)):
        result[1 : 1 + len(part)] += sign * part[: len(result) - 1]
    return result


def _derivative(coefficients: Array) -> Array:
    return np.asarray(coefficients[1:] * np.arange(1, len(coefficients))) if len(coefficients) > 1 else np.zeros(1)


def _powers(x: Array, y: Array) -> Powers:
    xx, yy = x * x, y * y
    return Powers(xx, x * y, yy, xx + yy)


def _polynomial(coefficients: Sequence[float], variable: Array) -> tuple[Array, Array]:
    """Return 1 + a₁t + a₂t² + … and its derivative at t = `variable` (n,), by Horner's rule."""
    value, slope = np.full_like(variable, coefficients[-1]), np.zeros_like(variable)
    for coefficient in (*coefficients[-2::-1], 1.0):
        slope *= variable
        slope += value
        value *= variable
        value += coefficient
    return value, slope


def _fill(rows: Array, columns: Columns, start: Array, square: Array) -> None:
    """Write start · r², start · r⁴, … into the rows of `columns`."""
    for column in columns:
        start = np.multiply(start, square, out=rows[column])
