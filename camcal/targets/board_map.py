"""The map from the plane of a board to pixels for an uncalibrated lens, fitted to its points.

A homography, which keeps straight lines straight, then a radial distortion, q = p / (1 + λ₁ r² + λ₂ r⁴ + λ₃ r⁶) with
p, r from a middle near the image's (the division model, Fitzgibbon 2001), which even few points determine; what these
leave is a polynomial in the board's plane of as high a degree as the points allow.
"""

import numpy as np

from camcal.arrays import Array
from camcal.dataclass import dataclass, replace

_LEAST_SIZE = 1e-12  # of points that lie in one place, so that nothing is divided by 0

_DEGREE = 5  # of the polynomial at most
_POINTS_PER_TERM = 3
_LEAST_RADIAL = 12  # points for a radial distortion
_ROUNDS = 8
_STEP = 1e-4  # of a radial term or of the middle, for derivatives
# What a hundredth of a pixel is in units of the scale, over the spreads of the terms and of the middle
_HELD = 2.5e-5 / np.array([1.0, 1.0, 1.0, 0.05, 0.05])
_REQUIRED_DECREASE = 0.99  # of the sum of squares that a round must fall below to be taken
_INVERSIONS = 12


def apply_homography(homography: Array, points: Array) -> Array:
    """Return where a homography (3, 3) takes points (N, 2)."""
    moved = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def homography_of(points: Array, seen: Array) -> Array:
    """Return the homography (3, 3) of least algebraic error from points (N, 2) to where they are seen (N, 2).

    N is 4 or more; its last entry is 1.
    Source: Hartley, In Defense of the Eight-Point Algorithm, 1997 (why both are normalised).
    """
    onto, back = _normalising(points), _normalising(seen)
    (x, y), (u, v) = apply_homography(onto, points).T, apply_homography(back, seen).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    upper = np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1)
    lower = np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1)
    design = np.concatenate([upper, lower])
    entries = np.linalg.eigh(design.T @ design)[1][:, 0]
    result = np.linalg.inv(back) @ entries.reshape(3, 3) @ onto
    return np.asarray(result / result[2, 2])


def _normalising(points: Array) -> Array:
    """Return the similarity (3, 3) that brings points (N, 2) around the origin and to unit size."""
    middle = points.mean(axis=0)
    scale = 1 / max(float(np.abs(points - middle).mean()), _LEAST_SIZE)
    return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class Radial:
    """A radial distortion about a middle (2,): terms (3,) of even powers of radii in units of `scale`."""

    middle: Array
    scale: float
    terms: Array

    def straight(self, pixels: Array) -> Array:
        """Return where a lens without distortion would show what is at pixels (N, 2)."""
        away = (pixels - self.middle) / self.scale
        return np.asarray(away / self._divisor((away * away).sum(axis=1, keepdims=True)))

    def bent(self, places: Array) -> Array:
        """Return the pixels (N, 2) of what `straight` takes to places (N, 2); by Newton's method on the radii."""
        wanted = np.linalg.norm(places, axis=1, keepdims=True)
        radius = wanted.copy()
        a, b, c = self.terms
        for _ in range(_INVERSIONS):
            square = radius * radius
            slope = 1 - 2 * wanted * radius * ((3 * c * square + 2 * b) * square + a)
            radius = radius - (radius - wanted * self._divisor(square)) / slope
        return np.asarray(places * self._divisor(radius * radius) * self.scale + self.middle)

    def _divisor(self, square: Array) -> Array:
        a, b, c = self.terms
        return np.asarray(1 + square * (a + square * (b + square * c)))


@dataclass(frozen=True, eq=False)
class BoardMap:
    """The polynomial with coefficients (T, 2) in the board's plane, then the homography (3, 3), then the lens."""

    coefficients: Array
    degree: int
    middle: Array
    scale: float
    homography: Array
    radial: Radial

    def pixels(self, points: Array) -> Array:
        """Return the pixels (..., 2) of points (..., 2) of the board."""
        flat = points.reshape(-1, 2)
        moved = flat + polynomial_terms((flat - self.middle) / self.scale, self.degree) @ self.coefficients
        return self.radial.bent(apply_homography(self.homography, moved)).reshape(points.shape)


def map_of(points: Array, pixels: Array, size: tuple[int, int], *, rough: bool = False) -> BoardMap:
    """Return the map that fits points (N, 2) of a board seen at pixels (N, 2) best, four of them at least.

    size: (width, height) of the image. rough: leave the radial distortion to the polynomial, which takes a tenth of the
    time.
    """
    radial = _undistorted(size) if rough else _radial(points, pixels, size)
    straight = radial.straight(pixels)
    homography = homography_of(points, straight)
    middle, scale = points.mean(axis=0), float(np.ptp(points, axis=0).max()) / 2
    # as high as points on the lines of a grid determine well
    lines, degree = min(len(np.unique(np.rint(1e6 * axis / np.ptp(axis)))) for axis in points.T), 0
    while degree < min(_DEGREE, lines - 2) and _POINTS_PER_TERM * (degree + 2) * (degree + 3) // 2 <= len(points):
        degree += 1
    moved = apply_homography(np.linalg.inv(homography), straight) - points
    terms = polynomial_terms((points - middle) / scale, degree)
    return BoardMap(np.linalg.lstsq(terms, moved, rcond=None)[0], degree, middle, scale, homography, radial)


def _radial(points: Array, pixels: Array, size: tuple[int, int]) -> Radial:
    """Return the radial distortion that leaves points and pixels (N, 2) closest to a homography.

    Gauss-Newton over its terms and its middle, which is held near the image's where distortion is too weak to tell it.
    """
    best = _undistorted(size)
    if len(points) < _LEAST_RADIAL:
        return best
    place, off = np.zeros(5), _residuals(points, pixels, best)
    for _ in range(_ROUNDS):
        nearby = [_move(best, step) for step in _STEP * np.eye(5)]
        slopes = np.stack([(_residuals(points, pixels, other) - off) / _STEP for other in nearby], axis=1)
        design, wanted = np.concatenate([slopes, np.diag(_HELD)]), np.concatenate([off, _HELD * place])
        step = -np.linalg.lstsq(design, wanted, rcond=None)[0]
        trial = _move(best, step)
        trial_off = _residuals(points, pixels, trial)
        if not (trial_off**2).sum() < _REQUIRED_DECREASE * (off**2).sum():
            break
        best, place, off = trial, place + step, trial_off
    return best


def _undistorted(size: tuple[int, int]) -> Radial:
    """Return no distortion of an image of a size (width, height)."""
    return Radial((np.array(size) - 1) / 2, float(np.hypot(*size)) / 2, np.zeros(3))


def _move(radial: Radial, step: Array) -> Radial:
    """Return a distortion with other terms and another middle; step: (5,), of the middle in units of the scale."""
    return replace(radial, terms=radial.terms + step[:3], middle=radial.middle + radial.scale * step[3:])


def _residuals(points: Array, pixels: Array, radial: Radial) -> Array:
    straight = radial.straight(pixels)
    return np.asarray((straight - apply_homography(homography_of(points, straight), points)).ravel())


def polynomial_terms(points: Array, degree: int) -> Array:
    """Return the products (N, T) of powers of x and y up to a degree."""
    x, y = points.T
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)
