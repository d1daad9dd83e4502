"""The inverse of a plane's distortion: the tilt in closed form, the radius by bracketed Newton steps, the rest by
damped Newton steps in two dimensions. Fixed-point iteration, which does for narrow lenses, diverges on wide ones.
"""

import numpy as np

from camcal.arrays import Array
from camcal.cameras.distortion import Distortion, Limit

FAR = 1e6  # the largest radius looked for on an unbounded plane: 1e-6 rad from 90° for a pinhole
# Residuals on the plane, relative to 1 + |target|: where to stop, and what still counts as solved when rounding
# stops the steps earlier (1e-12 is far below a micropixel).
ENOUGH, SOLVED = 1e-14, 1e-12
SMALLEST_STEP = 1e-4


def undistort(distortion: Distortion, x_d: Array, y_d: Array, limit: Limit) -> tuple[Array, Array, Array]:
    """Return the undistorted coordinates x, y (n,) and the mask (n,) of those found inside the limit."""
    tilt = distortion.tilt()
    target = np.stack([x_d, y_d] if tilt is None else tilt.undo(x_d, y_d))
    if not distortion.values:
        return target[0], target[1], (target**2).sum(axis=0) < limit.radius**2
    radius_d = np.sqrt(target[0] ** 2 + target[1] ** 2)
    radius = _undistort_radius(distortion, radius_d, limit)
    start = target * (radius / np.where(radius_d > 0, radius_d, 1.0))
    found, solved = _refine(distortion, np.stack([x_d, y_d]), start, limit)
    return found[0], found[1], solved


def _undistort_radius(distortion: Distortion, target: Array, limit: Limit) -> Array:
    """Return the r (n,) with r c(r²) = target (n,): Newton steps, bisection where they leave the bracket.

    A target past the fold is taken just inside: the other terms may still bring the point within reach.
    """
    low, high = np.zeros_like(target), np.full_like(target, min(limit.radius, FAR))
    target = np.minimum(target, 0.9999 * limit.distorted)
    radius = np.where(target < high, target, 0.5 * high)
    for _ in range(100):
        square = radius * radius
        ratio, slope = distortion.radial(square)
        excess = radius * ratio - target
        low, high = np.where(excess < 0, radius, low), np.where(excess < 0, high, radius)
        trial = radius - excess / (ratio + 2.0 * square * slope)
        trial = np.where((trial >= low) & (trial <= high), trial, 0.5 * (low + high))
        change = np.abs(trial - radius)
        radius = trial
        if not np.any(change > 1e-8 * radius):  # its square is the error left
            break
    return radius


def _refine(distortion: Distortion, target: Array, start: Array, limit: Limit) -> tuple[Array, Array]:
    """Return the points (2, n) that the distortion takes to target (2, n), and the mask (n,) of success.

    A step that does not bring a point nearer by its share, or leaves the domain, is halved; after one that does the
    next is doubled, up to a full step.
    """
    point = start.copy()
    error, step = _newton_step(distortion, point, target, limit)
    factor = np.ones_like(error)
    size = 1.0 + np.abs(target).max(axis=0)
    for _ in range(50):
        if not np.any((error > ENOUGH * size) & (factor > SMALLEST_STEP)):
            break
        trial = point + factor * step
        trial_error, trial_step = _newton_step(distortion, trial, target, limit)
        better = trial_error < (1.0 - 0.1 * factor) * error  # Armijo's rule: crawling towards the fold ends early
        factor = np.where(better, np.minimum(1.0, 2.0 * factor), 0.5 * factor)
        for kept, new in ((point, trial), (step, trial_step), (error, trial_error)):
            np.copyto(kept, new, where=better)
    return point, error < SOLVED * size


def _newton_step(distortion: Distortion, point: Array, target: Array, limit: Limit) -> tuple[Array, Array]:
    """Return the distance (n,) left to the target, inf outside the domain, and the Newton step (2, n)."""
    here = distortion.apply(point[0], point[1])
    left_x, left_y = target[0] - here.x, target[1] - here.y
    determinant = here.determinant()
    step = np.stack([here.y_y * left_x - here.x_y * left_y, here.x_x * left_y - here.y_x * left_x]) / determinant
    error = np.where(limit.holds(here), np.maximum(np.abs(left_x), np.abs(left_y)), np.inf)
    return error, step
